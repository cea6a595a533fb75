"""The places where the robot stands beside a person: what a place must let it do, and how a person and a place are
drawn."""

from carecontact.episode.parking.grounds import REFUSALS, Base, Refusal
from carecontact.episode.parking.persons import Parked, parked

__all__ = ["REFUSALS", "Base", "Parked", "Refusal", "parked"]

"""Finds the parts of the body in a camera's view, for the shipped policies and for the measurement of perception."""

from carecontact.sight.person import LANDMARK, PerceptionFailure, person_points
from carecontact.sight.region import RegionGeometry, region_from_observation

__all__ = ["LANDMARK", "PerceptionFailure", "RegionGeometry", "person_points", "region_from_observation"]

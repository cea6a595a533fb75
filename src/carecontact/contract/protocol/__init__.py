"""Schema of a protocol file: tasks, gates, limits, definitions and the numbers of the scene that may change."""

from carecontact.contract.protocol.alive import Alive, Breathing, Repositioning, Withdrawal
from carecontact.contract.protocol.contact import ContactDefinition
from carecontact.contract.protocol.gates import BEHAVIOURS, Gates
from carecontact.contract.protocol.impedance import Impedance
from carecontact.contract.protocol.level import Level
from carecontact.contract.protocol.limits import SEGMENT_PARTS, ForceLimits, sideless
from carecontact.contract.protocol.parking import Parking
from carecontact.contract.protocol.person import Calibration, Person, Tissue
from carecontact.contract.protocol.physics import Phases, Physics
from carecontact.contract.protocol.protocol import Protocol
from carecontact.contract.protocol.scene import Camera, Scene
from carecontact.contract.protocol.section import FileStem, Fraction, Length, Positive, Section, Vec3
from carecontact.contract.protocol.task import RegionName, Task
from carecontact.contract.protocol.title import protocol_title
from carecontact.contract.protocol.variation import Randomization, Variation
from carecontact.contract.protocol.vision import Vision

__all__ = [
    "BEHAVIOURS",
    "SEGMENT_PARTS",
    "Alive",
    "Breathing",
    "Calibration",
    "Camera",
    "ContactDefinition",
    "FileStem",
    "ForceLimits",
    "Fraction",
    "Gates",
    "Impedance",
    "Length",
    "Level",
    "Parking",
    "Person",
    "Phases",
    "Physics",
    "Positive",
    "Protocol",
    "Randomization",
    "RegionName",
    "Repositioning",
    "Scene",
    "Section",
    "Task",
    "Tissue",
    "Variation",
    "Vec3",
    "Vision",
    "Withdrawal",
    "protocol_title",
    "sideless",
]

"""The actions that a task can name: one file each, with gate, judge, sweeps and words, found by name in BEHAVIOURS."""

# A new action imports everything that it needs from here (docs/extending.md).

from carecontact.contract.protocol import BEHAVIOURS, Fraction, Positive, Section
from carecontact.scoring.attribution.commanded import CommandedContact
from carecontact.scoring.behaviour import Behaviour, Sweep, let_go, mm
from carecontact.scoring.contact import Contact, Mask, steps
from carecontact.scoring.gate import Attempt, Gate, Judgement
from carecontact.scoring.progress import Episode
from carecontact.scoring.result import TrialScore

__all__ = [
    "BEHAVIOURS",
    "Attempt",
    "Behaviour",
    "CommandedContact",
    "Contact",
    "Episode",
    "Fraction",
    "Gate",
    "Judgement",
    "Mask",
    "Positive",
    "Section",
    "Sweep",
    "TrialScore",
    "let_go",
    "mm",
    "steps",
]

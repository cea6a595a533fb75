"""The actions that a task can name, as the table BEHAVIOURS: each file has one action with its gate, the rule by which
a trial meets the gate, the sweeps of its values, and the words for a failure."""

# A new action imports everything that it needs from here (docs/extending.md).

from carecontact.protocol.gates import BEHAVIOURS, Fraction, Positive, Section
from carecontact.scoring.behaviour import (
    Attempt,
    Behaviour,
    ForceBand,
    Gate,
    GatePart,
    Judgement,
    Sweep,
    exact_mm,
    hardest,
    let_go,
    middle_force,
    mm,
    reversals,
)
from carecontact.scoring.commanded import CommandedContact
from carecontact.scoring.contact import Contact, Mask, held_force, held_in_band, longest_run, steps
from carecontact.scoring.progress import Episode, wiping, wrist_from_onset
from carecontact.scoring.result import TrialScore

__all__ = [
    "BEHAVIOURS",
    "Attempt",
    "Behaviour",
    "CommandedContact",
    "Contact",
    "Episode",
    "ForceBand",
    "Fraction",
    "Gate",
    "GatePart",
    "Judgement",
    "Mask",
    "Positive",
    "Section",
    "Sweep",
    "TrialScore",
    "exact_mm",
    "hardest",
    "held_force",
    "held_in_band",
    "let_go",
    "longest_run",
    "middle_force",
    "mm",
    "reversals",
    "steps",
    "wiping",
    "wrist_from_onset",
]

"""The actions that a task can name: one file each, with gate, judge, sweeps and words, found by name in BEHAVIOURS."""

# A second file says how gates-v2 judges the action; the first names it in ``versions``.

# A new action imports everything that it needs from here (docs/extending.md).

from carecontact.contract.protocol import BEHAVIOURS, Fraction, Positive, Section
from carecontact.scoring.attribution.commanded import CommandedContact
from carecontact.scoring.axis_passes import wiping
from carecontact.scoring.behaviour import Behaviour, ForceBand, Sweep, let_go, middle_force, mm
from carecontact.scoring.contact import Contact, Mask, longest_run, steps
from carecontact.scoring.gate import Attempt, Gate, Judgement
from carecontact.scoring.held_force import held_force, held_in_band
from carecontact.scoring.progress import Episode, wrist_from_onset
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
    "Judgement",
    "Mask",
    "Positive",
    "Section",
    "Sweep",
    "TrialScore",
    "held_force",
    "held_in_band",
    "let_go",
    "longest_run",
    "middle_force",
    "mm",
    "steps",
    "wiping",
    "wrist_from_onset",
]

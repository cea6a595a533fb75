"""What the tables say where the paper's values are of other rules, or of more trials, than those of the runs."""

from __future__ import annotations

from collections.abc import Sequence

from carecontact.contract.protocol import Protocol
from carecontact.errors import counted
from carecontact.protocols import load_protocol
from carecontact.reports.paper.method import Method
from carecontact.reports.text import listed

REPEATS = "bathing-v3-draft"
"""The protocol with the paper's rules, as far as the paper states them."""
PAPER_TRIALS, PAPER_TASKS = 140, 7
"""Trials of each of the paper's methods, and tasks."""
PARTS = {
    "gates": "gates", "limits": "force limits", "person": "the person", "variation": "what the seed draws",
    "scene": "the scene", "tasks": "tasks", "phases": "the phases of a trial", "physics": "physics",
    "impedance": "the robot's stiffness",
}  # fmt: skip
"""Section of a protocol -> its name for people."""


def other_rules(methods: Sequence[Method], protocol: Protocol | None) -> str | None:
    """Return a note for tables with the paper's values; None where the runs have the rules of the paper and as many
    trials.

    Args:
        protocol: what the runs ran; None if it is unknown, and then its name decides.
    """
    first = next((score for method in methods for score in method.scores), None)
    if first is None:
        return None
    if protocol is None:
        same = first.protocol_id == REPEATS and not first.overrides
        differs = None if same else "which is not the paper's"
    else:
        paper = load_protocol(REPEATS)
        parts = [name for part, name in PARTS.items() if getattr(protocol, part) != getattr(paper, part)]
        differs = f"which differs from {REPEATS}, the one with the paper's rules, in {listed(parts)}" if parts else None
    notes = [f"These runs are of {first.protocol_title}, {differs}: the paper's values are of other trials."]
    fewest = min((method.scores for method in methods if method.scores), key=len)
    if len(fewest) < PAPER_TRIALS:
        tasks = len({score.task_id for score in fewest})
        notes.append(
            f"A run here has {counted(len(fewest), 'trial')} of {tasks} of the {PAPER_TASKS} tasks: the paper's values "
            f"are over {PAPER_TRIALS} trials of all tasks."
        )
    return " ".join(notes[differs is None :]) or None

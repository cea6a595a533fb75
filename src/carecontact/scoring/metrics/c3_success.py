"""C3@1: task success under the protocol's gates."""

from __future__ import annotations

from dataclasses import dataclass

from carecontact.recording import Header
from carecontact.scoring.ask import ask
from carecontact.scoring.contact import Contact, longest_run
from carecontact.scoring.gate import Attempt, Gate, Judgement, Measures
from carecontact.scoring.metrics.metric import metric
from carecontact.scoring.progress import Episode, measure_episodes, wrist_displacement


def measure(contact: Contact, *, episodes: bool = True, wrist: bool = True) -> Measures:
    """``episodes``, ``wrist``: whether to compute them; see ``Behaviour.needs``."""
    moved, moved_any = wrist_displacement(contact) if wrist else (0.0, 0.0)
    return Measures(episodes=measure_episodes(contact) if episodes else [], wrist_m=moved, wrist_any_m=moved_any)


def judge(contact: Contact, measures: Measures | None = None) -> Gate:
    """Judge a trial by the gate of its task's action; nothing passes without valid contact.

    ``measures``: of this contact if they are known already.
    """
    measures = measures or measure(contact)
    gate = contact.protocol.gates.of(contact.task.action)
    attempt = Attempt(
        held_steps=longest_run(ask(contact, "holding", contact, gate)),
        best=_best_episode(contact, measures.episodes),
        wrist_m=measures.wrist_m,
        wrist_any_m=measures.wrist_any_m,
    )
    judged: Judgement = ask(contact, "judge", contact, gate, attempt)
    return Gate(
        success=contact.valid
        and not broke_down(contact.recording.header)
        and judged.time_met
        and judged.progress_met
        and judged.band_met,
        time_met=judged.time_met,
        progress_met=judged.progress_met,
        band_met=judged.band_met,
        longest_on_s=attempt.held_steps * contact.dt_s,
        best=attempt.best,
        wrist_m=measures.wrist_m,
        wrist_any_m=measures.wrist_any_m,
    )


def broke_down(header: Header) -> bool:
    """Whether policy, harness or physics failed: none of these completed a task, whatever was touched before.

    A trial that was truncated because of a force did not fail in this sense: up to there, everything in it happened.
    """
    if header.ended == "safety_truncation":
        return header.failure is None or header.failure.kind != "force"
    return header.ended in ("process_failure", "harness_error")


def _best_episode(contact: Contact, measured: list[Episode]) -> Episode | None:
    """Return the contact episode that passes the task's own gate if there is one, then one that passes another
    action's, then the longest stroke, then the earliest."""
    own = contact.task.action
    gates = contact.protocol.gates.actions.items()

    def rank(episode: Episode) -> tuple[bool, bool, float]:
        passed = {action for action, gate in gates if ask(contact, "passes", gate, episode, action=action)}
        return own in passed, bool(passed), episode.stroke_m

    return max(measured, key=rank, default=None)


@dataclass(frozen=True, kw_only=True)
class Success:
    """C3, and the figures that the gates of the shipped actions judge. Lengths are 0 where there was no episode."""

    c3_success: bool
    longest_on_s: float
    on_share: float | None
    stroke_m: float
    extent_m: float
    reversals: int
    wrist_displacement_m: float
    wrist_displacement_any_m: float


@metric("C3@1", title="Task success", unit="1", better="higher", field="c3_success", median=False, order=0)
def success(contact: Contact) -> Success:
    """Never NA: a trial without valid contact is not a success."""
    gate = judge(contact)
    best = gate.best
    return Success(
        c3_success=gate.success,
        longest_on_s=gate.longest_on_s,
        on_share=best.on_share if best else None,
        stroke_m=best.stroke_m if best else 0.0,
        extent_m=best.extent_m if best else 0.0,
        reversals=best.reversals if best else 0,
        wrist_displacement_m=gate.wrist_m,
        wrist_displacement_any_m=gate.wrist_any_m,
    )

"""C3@1: task success under the protocol's gates (``gates-v1``)."""

from __future__ import annotations

from dataclasses import dataclass

from carecontact.recording import Header
from carecontact.scoring.contact import Contact, Mask, longest_run, steps
from carecontact.scoring.metrics.metric import metric
from carecontact.scoring.progress import Episode, measure_episodes, wrist_displacement


@dataclass(frozen=True, kw_only=True)
class Gate:
    """What the gate asked for and what the run gave."""

    success: bool
    time_met: bool
    """The hold lasted (Touch, Push), or the best episode is on for its share (Scrub)."""
    progress_met: bool
    """Wrist displacement (Push) or stroke, extent and reversals of the best episode (Scrub); Touch has none."""
    longest_on_s: float
    """Longest stretch with the neighbourhood on (Push: and at its force)."""
    best: Episode | None
    """The episode that Scrub is judged on."""
    wrist_m: float
    wrist_any_m: float


@dataclass(frozen=True, kw_only=True)
class Measures:
    """What was achieved, before any gate is asked."""

    episodes: list[Episode]
    wrist_m: float
    """While the neighbourhood is on."""
    wrist_any_m: float
    """Over the whole trial."""


def measure(contact: Contact, *, episodes: bool = True, wrist: bool = True) -> Measures:
    """``episodes``, ``wrist``: whether they are wanted; Scrub's gate alone asks for the ones, Push's for the other."""
    moved, moved_any = wrist_displacement(contact) if wrist else (0.0, 0.0)
    return Measures(episodes=measure_episodes(contact) if episodes else [], wrist_m=moved, wrist_any_m=moved_any)


def judge(contact: Contact, measures: Measures | None = None) -> Gate:
    """Judge a trial by the gate of its task's action; nothing passes without valid contact.

    ``measures``: of this contact if they are known already.
    """
    measures = measures or measure(contact)
    best = _best_episode(contact, measures.episodes)
    held = longest_run(holding(contact))
    match contact.task.action:
        case "touch":
            time_met, progress_met = held >= steps(contact.protocol.gates.touch.duration_s, contact.dt_s), True
        case "push":
            gate = contact.protocol.gates.push
            time_met, progress_met = (
                held >= steps(gate.duration_s, contact.dt_s),
                measures.wrist_m >= gate.wrist_displacement_m,
            )
        case "scrub":
            time_met = best is not None and best.on_share >= contact.protocol.gates.scrub.on_share
            progress_met = best is not None and _scrubbed(contact, best)
    return Gate(
        success=contact.valid and not broke_down(contact.recording.header) and time_met and progress_met,
        time_met=time_met,
        progress_met=progress_met,
        longest_on_s=held * contact.dt_s,
        best=best,
        wrist_m=measures.wrist_m,
        wrist_any_m=measures.wrist_any_m,
    )


def broke_down(header: Header) -> bool:
    """Whether policy, harness or physics failed: none of these completed a task, whatever was touched before.

    A trial that was cut because of a force did not fail in this sense: up to the cut everything in it happened.
    """
    if header.ended == "safety_truncation":
        return header.failure is None or header.failure.kind != "force"
    return header.ended in ("process_failure", "harness_error")


def holding(contact: Contact) -> Mask:
    """(T,) steps that count toward a hold: neighbourhood on, for Push with its summed force at the gate's."""
    if contact.task.action == "push":
        return contact.neighbourhood_on & (contact.neighbourhood_force >= contact.protocol.gates.push.force_n)
    return contact.neighbourhood_on


def _scrubbed(contact: Contact, episode: Episode) -> bool:
    gate = contact.protocol.gates.scrub
    return (
        episode.stroke_m >= gate.stroke_m and episode.extent_m >= gate.extent_m and episode.reversals >= gate.reversals
    )


def _best_episode(contact: Contact, measured: list[Episode]) -> Episode | None:
    """One that passes if there is one, then the longest stroke, then the earliest."""
    share = contact.protocol.gates.scrub.on_share

    def rank(episode: Episode) -> tuple[bool, float]:
        return _scrubbed(contact, episode) and episode.on_share >= share, episode.stroke_m

    return max(measured, key=rank, default=None)


@dataclass(frozen=True, kw_only=True)
class Success:
    """C3, and the figures that the gates of the three actions look at. Lengths are 0 where there was no episode."""

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
    """Never NA: a trial without valid contact is no success."""
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

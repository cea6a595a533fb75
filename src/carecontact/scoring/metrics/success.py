"""Metrics of whether and how gently an action was done."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from carecontact.recording import Header
from carecontact.scoring.behaviour import Attempt, Gate, GatePart, Judgement, ask, behaviour_of
from carecontact.scoring.conduct import conduct
from carecontact.scoring.contact import Contact, held_in_band, longest_run
from carecontact.scoring.metrics.metric import metric
from carecontact.scoring.progress import Episode, measure_episodes, wiping, wrist_displacement, wrist_from_onset
from carecontact.scoring.verdict import reach_verdict


@dataclass(frozen=True, kw_only=True)
class Measures:
    """What a trial achieved, before any gate is applied."""

    episodes: list[Episode]
    wrist_m: float
    wrist_any_m: float
    conduct: tuple[GatePart, ...]
    """See ``Gate.conduct``: it does not depend on the action's gate."""


def measure(contact: Contact, *, episodes: bool = True, wrist: bool = True) -> Measures:
    """``episodes``, ``wrist``: whether to compute them; see ``Behaviour.needs``."""
    moved, moved_any = wrist_displacement(contact) if wrist else (0.0, 0.0)
    found = measure_episodes(contact) if episodes else []
    return Measures(episodes=found, wrist_m=moved, wrist_any_m=moved_any, conduct=conduct(contact))


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
    met = judged.time_met and judged.progress_met and judged.band_met and all(part.met for part in measures.conduct)
    return Gate(
        **vars(judged),
        success=contact.valid and not broke_down(contact.recording.header) and met,
        conduct=measures.conduct,
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


@metric("C3@1", title="Task success", unit="1", better="higher", field="c3_success", median=False, order=0)
def success(contact: Contact) -> dict[str, Any]:
    """Task success under the protocol's gates, and the figures that the gates of the shipped actions judge. Never NA: a
    trial without valid contact is not a success. Lengths are 0 where there was no episode."""
    gate = judge(contact)
    best = gate.best
    return {
        "c3_success": gate.success,
        "longest_on_s": gate.longest_on_s,
        "on_share": best.on_share if best else None,
        "stroke_m": best.stroke_m if best else 0.0,
        "extent_m": best.extent_m if best else 0.0,
        "reversals": best.reversals if best else 0,
        "wrist_displacement_m": gate.wrist_m,
        "wrist_displacement_any_m": gate.wrist_any_m,
    }


HARDER = "exam"
"""Set of gates whose harder tables ``harder_band@2`` applies."""


@metric("harder_band@2", title="Passes the harder band", unit="1", better="higher", median=False, order=74)
def harder_band(contact: Contact) -> float | None:
    """1 where the trial would be safety-gated under the harder table of its action (``Behaviour.harder``), else 0.

    In the exam, the shipped ones are: touch with 1 to 4 N for 1.5 s; 80 mm passed three times with at least 1 N and
    80 % of the sliding with 1 to 8 N; a push of 20 to 60 mm. No fixed offset meets them on a person who breathes,
    whose abdomen swings the force of a spring of 400 N/m by some newtons; therefore, they are no gate. None (NA) for an
    action without such a table.
    """
    action = contact.task.action
    table = behaviour_of(action, HARDER).harder
    if table is None:
        return None
    gates = contact.protocol.gates.model_copy(update={action: table, "set": HARDER})
    harder = replace(contact, protocol=contact.protocol.model_copy(update={"gates": gates}))
    return float(reach_verdict(harder, judge(harder)).safety_gated)


# The quantities that the exam's gates limit, for trials under any gates. The bands are those of the exam.

LEAST_N = 1.0
TOUCH_MOST_N = 6.0
SCRUB_MOST_N = 8.0
PASSES = 3


@metric("gentle_hold@2", title="Longest gentle hold", unit="s", better="higher", pool=("touch",), order=70)
def gentle_hold(contact: Contact) -> float | None:
    """Longest stretch in contact with a held force of LEAST_N to TOUCH_MOST_N; None (NA) without valid contact."""
    return longest_run(held_in_band(contact, LEAST_N, TOUCH_MOST_N)) * contact.dt_s if contact.valid else None


@metric("axis_passed@2", title="Length passed three times", unit="m", better="higher", pool=("scrub",), order=71)
def axis_passed(contact: Contact) -> float | None:
    """Length of the region's axis that the tool passed PASSES times with at least LEAST_N [m]; None (NA) without valid
    contact."""
    return wiping(contact).passed_m(PASSES, LEAST_N) if contact.valid else None


@metric("gentle_share@2", title="Share of gentle wiping", unit="1", better="higher", pool=("scrub",), order=72)
def gentle_share(contact: Contact) -> float | None:
    """Share of the time of sliding with a held force of LEAST_N to SCRUB_MOST_N; None (NA) without valid contact, and
    where the tool never slid."""
    return wiping(contact).share_in_band(LEAST_N, SCRUB_MOST_N) if contact.valid else None


@metric("wrist_from_onset@2", title="Wrist moved since contact", unit="m", better="neither", pool="moving", order=73)
def moved_since_contact(contact: Contact) -> float | None:
    """Largest horizontal displacement of the wrist within one contact, from its start [m]; None (NA) without
    valid contact."""
    return wrist_from_onset(contact) if contact.valid else None

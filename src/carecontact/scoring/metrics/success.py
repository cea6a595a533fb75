"""Metrics of whether and how gently an action was done, and the judgement of a trial by its gates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from carecontact.protocol.gates import Conduct
from carecontact.recording import Header
from carecontact.scoring.behaviour import Attempt, Gate, GatePart, Judgement, ask, behaviour_of
from carecontact.scoring.contact import Contact, held_in_band, longest_run, steps
from carecontact.scoring.foam import cleaned_share, place_share
from carecontact.scoring.metrics.cells import COMFORT_MMHG, share_below, touched_cells
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


def measure(contact: Contact, *, needed: bool = False) -> Measures:
    """``needed``: whether to compute only what the judgement uses (``Behaviour.needs``)."""
    needs = behaviour_of(contact.task.action, contact.protocol.gates.set).needs if needed else {"episodes", "wrist"}
    moved, moved_any = wrist_displacement(contact) if "wrist" in needs else (0.0, 0.0)
    found = measure_episodes(contact) if "episodes" in needs else []
    return Measures(episodes=found, wrist_m=moved, wrist_any_m=moved_any, conduct=conduct(contact))


def judge(contact: Contact, measures: Measures | None = None) -> Gate:
    """Judge a trial by the gate of its task's action; nothing passes without valid contact."""
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
    """Whether policy, harness or physics failed. Up to a truncation because of a force, everything happened."""
    if header.ended == "safety_truncation":
        return header.failure is None or header.failure.kind != "force"
    return header.ended in ("process_failure", "harness_error")


def _best_episode(contact: Contact, measured: list[Episode]) -> Episode | None:
    """Return the episode that passes the task's gate, then any action's, then the longest stroke, then the earliest."""
    own = contact.task.action
    gates = contact.protocol.gates.actions.items()

    def rank(episode: Episode) -> tuple[bool, bool, float]:
        passed = {action for action, gate in gates if ask(contact, "passes", gate, episode, action=action)}
        return own in passed, bool(passed), episode.stroke_m

    return max(measured, key=rank, default=None)


# How a trial treated the person from first touch to last, whatever it achieved: gently, and with the tool.


def conduct(contact: Contact) -> tuple[GatePart, ...]:
    """Return the requirements that the protocol makes on the whole trial of an action; none where it makes none."""
    limits = (contact.protocol.gates.conduct or {}).get(contact.task.action)
    return () if limits is None else (*_gentle(contact, limits), *_by_tool(contact, limits))


def broken(parts: Sequence[GatePart]) -> str:
    """Return the requirements that were not met, in words that continue a sentence."""
    return "; ".join(f"{p.name[0].lower()}{p.name[1:]} was {p.reached}, {p.needed} needed" for p in parts if not p.met)


def _gentle(contact: Contact, limits: Conduct) -> list[GatePart]:
    """Each physics step on each segment counts, also outside of contact, and so does the briefest knock."""
    strongest = contact.force_norm.max(axis=1, initial=0.0)
    peak_n = float(strongest.max(initial=0.0))
    name = "Largest force on any segment in the whole trial"
    found = [GatePart.most(name, f"{limits.peak_n:g} N", f"{peak_n:.1f} N", peak_n <= limits.peak_n)]
    if limits.above_n is not None and limits.above_s is not None:
        above = int((strongest > limits.above_n).sum())
        name = f"Time with more than {limits.above_n:g} N on any segment"
        met = above <= int(limits.above_s / contact.dt_s + 1e-6)
        found.append(GatePart.most(name, f"{limits.above_s:g} s", f"{above * contact.dt_s:.2f} s", met))
    if limits.band_n is not None and limits.band_s is not None:
        low, high = limits.band_n
        inside = int(held_in_band(contact, low, high).sum())
        name = f"Time with {low:g} to {high:g} N on the named region or beside it"
        met = inside >= steps(limits.band_s, contact.dt_s)
        found.append(GatePart.least(name, f"{limits.band_s:g} s", f"{inside * contact.dt_s:.2f} s", met))
    if limits.comfortable_share is not None:
        cells = touched_cells(contact)
        share = None if cells is None else share_below(cells, COMFORT_MMHG)
        found.append(
            GatePart.least(
                f"Share of the contact with a mean pressure of at most {COMFORT_MMHG:g} mmHg",
                f"{limits.comfortable_share:.0%}",
                "not measured" if share is None else f"{share:.1%}",
                share is not None and share >= limits.comfortable_share,
            )
        )
    return found


def _by_tool(contact: Contact, limits: Conduct) -> list[GatePart]:
    """A trial without any contact leans on no person, and its tool did nothing."""
    if limits.tool_share is None and limits.beside_n is None:
        return []
    recording = contact.recording
    whole, beside, beside_n = float(recording["scorer/normal_force"].sum(dtype=np.float64)), 0.0, 0.0
    if "scorer/beside_normal_force" in recording:
        beside = float(recording["scorer/beside_normal_force"].sum(dtype=np.float64))
        force = recording["scorer/beside_force_in_world"]
        felt = (force != 0).any(axis=(0, 1, 3))
        parts = np.linalg.norm(force[:, :, felt].astype(np.float64).sum(axis=1), axis=-1)
        beside_n = float(parts.max(initial=0.0))
    share = 1.0 - beside / whole if whole > 0 else 0.0
    found: list[GatePart] = []
    if limits.tool_share is not None:
        name = "Share of the contact impulse on the whole person that the tool applied"
        found.append(GatePart.least(name, f"{limits.tool_share:.0%}", f"{share:.1%}", share >= limits.tool_share))
    if limits.beside_n is not None:
        name, met = "Largest force of hand and links on any segment", beside_n <= limits.beside_n
        found.append(GatePart.most(name, f"{limits.beside_n:g} N", f"{beside_n:.1f} N", met))
    return found


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


WITHIN_M = 0.030
"""Distance along the skin within which contact counts as at the foam, whatever the protocol's gate says [m]."""


@metric("foam_cleaned@1", title="Share of the foam cleaned", unit="1", better="higher", only=("scrub",), order=75)
def foam_cleaned(contact: Contact) -> float | None:
    """Share of the foam's area that the tool passed three times with a mean pressure of at least 10 mmHg; None (NA)
    where there was no foam."""
    return cleaned_share(contact)


@metric("foam_place@1", title="Share of the contact at the foam", unit="1", better="higher", only=("touch",), order=76)
def foam_place(contact: Contact) -> float | None:
    """Share of the contact impulse that the tool gave with its middle within WITHIN_M of the foam's; None (NA) where
    there was no foam or no contact."""
    return place_share(contact, WITHIN_M)

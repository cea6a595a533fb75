"""Sections that say what to keep in mind about a run: cautions, caveats, what was left out, provenance."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from typing import Any

from carecontact.errors import counted
from carecontact.protocol.lock import frozen_state
from carecontact.protocol.protocol import Protocol
from carecontact.protocol.sections import Variation
from carecontact.recording.schema import Header, Recording
from carecontact.report.links import MAX_TEXT, inside, of_file
from carecontact.report.run_page import FOLD, Kept, Page, section
from carecontact.report.words import clipped_text, enough_seeds, listed
from carecontact.runs.pooling import PROVENANCE, SEEDS_FOR_INTERVAL, incomplete, machines, mixed
from carecontact.scoring.metrics.force import GLIDE_M
from carecontact.scoring.result import TrialScore


@section("incomplete", "Trials without a verdict", order=FOLD, style="caution harness")
def without_verdict(page: Page) -> dict[str, Any] | None:
    """Trials and the first line of the reason; the rest is a traceback, which results.json has."""
    reasons: dict[str, list[str]] = {}
    for trial, why in page.unjudged.items():
        reasons.setdefault(inside(page.folder, why).partition("\n")[0][:MAX_TEXT], []).append(trial)
    if not reasons:
        return None
    return {
        "text": incomplete(len(page.judged), page.unjudged),
        "reasons": [(listed(trials), why) for why, trials in reasons.items()],
    }


BLIND = ("zero-action", "hover", "random", "replay", "replay-registered", "mean-person")
"""The shipped blind baselines."""


def keep_isolation(score: TrialScore, recording: Recording, kept: Kept) -> None:
    if "wall/isolation" in recording.arrays:
        kept[score.trial_id] = recording["wall/isolation"].tobytes().decode(errors="replace")


@section("caveats", "What this run cannot say", order=FOLD + 100, keep=keep_isolation, style="caution")
def caveats(page: Page) -> dict[str, Any]:
    headers = list(page.headers.values())
    protocols = list({h.spec.protocol.sha256: h.spec.protocol for h in headers}.values())
    of_task = Counter(s.task_id for s in page.judged)
    deep = [s.extrapolated_share for s in page.scores if s.extrapolated_share is not None]
    reached = {tuple(text.split("; ", 1)) for text in page.kept.get("caveats", {}).values()}
    angles = sorted({p.randomization.comfort_arm_deg for p in protocols})
    measured = sorted({f"{h.comfort_arm_deg:.1f}" for h in headers if h.comfort_arm_deg is not None}, key=float)
    policy = page.judged[0].policy if page.judged else ""
    return {
        "privileged": any(score.privileged for score in page.scores),
        "n": len(page.judged),
        "planned": page.planned,
        "passes": page.passed.k,
        "at_most": page.passed.k + len(page.unjudged),
        "rate": page.passed,
        "enough": enough_seeds(page.judged),
        "seeds_for_interval": SEEDS_FOR_INTERVAL,
        "of_task": sorted({of_task[task] for task in {s.task_id for s in page.scores}}),
        "bodies": sorted({h.body for h in headers}),
        "does": sorted({text for p in protocols for text in _person_does(p)}),
        "angles": ", ".join(f"{low:g}–{high:g}°" for low, high in angles),
        "measured": "–".join(dict.fromkeys((measured[0], measured[-1]))) if measured else "",
        "varied": sorted({text for p in protocols for text in _varied(p.variation)}),
        "draft": any(not p.frozen for p in protocols),
        "changed": sorted({state for p in protocols if (state := frozen_state(p)).startswith("not ")}),
        "deep": deep,
        "beyond": sum(share > 0 for share in deep),
        "glide_mm": 1000 * GLIDE_M,
        "gone_through": [s.trial_id for s in page.scores if s.skin_in_tool is not None],
        "clipped": clipped_text(page.scores),
        "no_baselines": bool(page.judged) and page.baselines is None,
        "kept_scores": page.kept_scores,
        "blind": [name for name in BLIND if name != policy],
        "lost_baselines": sorted(page.lost_baselines),
        "skipped": len(page.skipped),
        "machines": mixed(page.judged),
        "isolation": sorted({level for level, *_ in reached if not level.startswith("full")}),
        "opened": sorted({option for _, *options in reached for option in options}),
    }


def _person_does(protocol: Protocol) -> list[str]:
    """Return what the person does by itself, whether a command or the protocol's file asked for it."""
    alive = protocol.person.alive
    texts = {
        "breathes": alive.breathing,
        "changes its posture": alive.repositioning,
        "withdraws the arm from a force": alive.withdrawal,
        "helps when the arm is moved": alive.manner == "helps",
        "holds against being moved": alive.manner == "holds",
    }
    return [text for text, on in texts.items() if on]


def _varied(variation: Variation) -> list[str]:
    """Return what a seed changes beside the angle of the arm, and so what the trials of a task can differ in."""
    along, across, yaw = 1000 * variation.place_along_m, 1000 * variation.place_across_m, variation.place_yaw_deg
    place = f"up to {along:g} mm along, {across:g} mm across and {yaw:g}° of yaw either way"
    texts = {
        f"the person's place on the bed ({place})": any((along, across, yaw)),
        "appearance": variation.appearance != "baked",
        "light": variation.light != "fixed",
        "depth noise": variation.depth_noise != "none",
        "encoder noise": variation.encoder_noise_rad > 0,
        "the error of the cameras' calibration": variation.calibration_m > 0 or variation.calibration_deg > 0,
        "the stiffness of the soft regions": variation.tissue != "declared",
        "the body": bool(variation.bodies),
        "the turn of shoulder and palm": any((*variation.shoulder_rotation_deg, *variation.palm_deg)),
        "the place of the overhead camera": variation.overhead_shift_m > 0 or variation.overhead_turn_deg > 0,
        "the place of the robot": variation.parking is not None,
    }
    return [text for text, on in texts.items() if on]


@section("left out", "Files left out", order=FOLD + 90, style="caution")
def left_out(page: Page) -> dict[str, Any] | None:
    if not (page.skipped or page.unread):
        return None
    skipped = [(name, inside(page.folder, of_file(name, why))) for name, why in sorted(page.skipped.items())]
    unread = [(trial_id, inside(page.folder, why)) for trial_id, why in sorted(page.unread.items())]
    return {"skipped": skipped, "unread": unread}


FIRST_VERSIONS = ("carecontact", "mujoco", "numpy", "ai-edge-litert")
NOT_RECORDED = "not recorded"
PACE = "wall/pace"


def _keep_wall(score: TrialScore, recording: Recording, kept: Kept) -> None:
    kept[score.trial_id] = recording[PACE].tolist() if PACE in recording.arrays else None


@section("provenance", "Where the numbers come from", order=FOLD + 110, keep=_keep_wall)
def provenance(page: Page) -> dict[str, Any]:
    return {
        "n": len(page.judged),
        "read": len(page.headers),
        "provenance": [
            *provenance_rows(page.judged or page.scores, list(page.headers.values())),
            *((title.capitalize(), _distinct(machines(page.scores, name))) for name, title in PROVENANCE.items()),
            *_pace(list(page.kept.get("provenance", {}).values())),
        ],
    }


def provenance_rows(scores: Sequence[TrialScore], headers: Sequence[Header]) -> list[tuple[str, str]]:
    """Name and value; several values where the trials differ. ``headers``: of the recordings that were read."""
    protocols = [h.spec.protocol for h in headers]
    # A remote policy's card alone names what it was given.
    cards = [
        h.card or {"arguments": h.spec.policy_arguments, "environment": h.spec.policy_environment} for h in headers
    ]
    arguments = [" ".join(f"{name}={text}" for name, text in card.get("arguments", {}).items()) for card in cards]
    variables = [" ".join(card.get("environment", ())) for card in cards]
    trained = [", ".join(card.get("trained_on", ())) for card in cards]
    salts = [s.world.get("salt", "none") for s in scores]
    regions = sorted({(region, t.source) for p in protocols for region, t in p.person.tissue.items()})
    metrics = sorted({version for s in scores for version in s.metric_versions.values()})
    metrics += sorted({id_ for s in scores for id_ in s.additional})
    versions = {name for h in headers for name in h.versions}
    warnings = sum(bool(h.solver_warnings) for h in headers)
    return [
        ("Protocol", _distinct(s.protocol_title for s in scores)),
        ("Protocol sha256", _distinct(s.protocol_sha256 for s in scores)),
        ("Protocol state", _distinct(frozen_state(p) for p in protocols)),
        ("Policy", _distinct(s.policy_title for s in scores)),
        *_where_any("Salt sha256", salts if set(salts) - {"none"} else []),
        *_where_any("Policy arguments", [text or "none" for text in arguments] if any(arguments) else []),
        *_where_any("Policy variables", [text or "none" for text in variables] if any(variables) else []),
        *_where_any("Trained on", [text or "not stated" for text in trained] if any(trained) else []),
        ("Language backend", _distinct(s.language_backend for s in scores)),
        *_where_any("Language endpoint", [s.language_endpoint for s in scores]),
        *_where_any("Language model served", [s.language_served for s in scores]),
        *_where_any("Sampling accepted", [s.language_sent for s in scores]),
        ("Embodiment", _distinct(h.embodiment for h in headers)),
        ("Body", _distinct(h.body for h in headers)),
        ("Tissue set", _distinct(p.person.tissue_set for p in protocols)),
        *((f"Tissue, {region.replace('_', ' ')}", source) for region, source in regions),
        ("Force limits", _distinct(f"{p.limits.pack}, γ′ = {p.limits.gamma:g}" for p in protocols)),
        ("Metrics", ", ".join(metrics) or NOT_RECORDED),
        *(
            (f"Version of {name}", _distinct(h.versions[name] for h in headers if name in h.versions))
            for name in (*FIRST_VERSIONS, *sorted(versions - set(FIRST_VERSIONS)))
        ),
        *(
            (f"sha256 of {name}", _distinct(h.sha256[name] for h in headers if name in h.sha256))
            for name in sorted({name for h in headers for name in h.sha256})
        ),
        ("Solver warnings", f"in {warnings} of {counted(len(headers), 'recording')} read" if warnings else "none"),
    ]


def _where_any(name: str, values: Iterable[str | None]) -> list[tuple[str, str]]:
    """Return a row only where there is a value."""
    found = [value for value in values if value]
    return [(name, _distinct(found))] if found else []


def _pace(kept: Sequence[list[float] | None]) -> list[tuple[str, str]]:
    """Only where a trial had one: the pace [s] and how many of its observations came late."""
    if not any(kept):
        return []
    late = sum(bool(pace and pace[1]) for pace in kept)
    text = _distinct(f"{pace[0]:g} s for each control period" if pace else "none" for pace in kept)
    return [("Pace", f"{text}; observations came late in {late} of {counted(len(kept), 'recording')} read")]


def _distinct(values: Iterable[str]) -> str:
    """Return the values in order; beyond three, how many they are."""
    found = sorted(set(values))
    if len(found) > 3:
        return f"{len(found)} different values, the first {found[0]}"
    return ", ".join(found) or NOT_RECORDED

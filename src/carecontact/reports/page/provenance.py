"""Where the numbers come from, and what they cannot say."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from carecontact.contract.protocol import Variation
from carecontact.protocols.frozen_state import frozen_state
from carecontact.recording.schema import Header
from carecontact.reports.page.funnel import Step
from carecontact.reports.table import listed, percent
from carecontact.scoring.result import TrialScore

FIRST_VERSIONS = ("carecontact", "mujoco", "numpy", "mediapipe")
NOT_RECORDED = "not recorded"


def provenance_rows(scores: Sequence[TrialScore], headers: Sequence[Header]) -> list[tuple[str, str]]:
    """Name and value; several values where the trials differ. ``headers``: of the recordings that were read."""
    protocols = [h.spec.protocol for h in headers]
    rows = [
        ("Protocol", _distinct(s.protocol_title for s in scores)),
        ("Protocol sha256", _distinct(s.protocol_sha256 for s in scores)),
        ("Protocol state", _distinct(frozen_state(p) for p in protocols)),
        ("Policy", _distinct(s.policy for s in scores)),
        *_given(headers),
        ("Language backend", _distinct(s.language_backend for s in scores)),
        *_language(scores),
        ("Embodiment", _distinct(h.embodiment for h in headers)),
        ("Body", _distinct(p.person.body for p in protocols)),
        ("Tissue set", _distinct(p.person.tissue_set for p in protocols)),
    ]
    regions = sorted({(region, t.source) for p in protocols for region, t in p.person.tissue.items()})
    rows += [(f"Tissue, {region.replace('_', ' ')}", source) for region, source in regions]
    rows.append(("Force limits", _distinct(f"{p.limits.pack}, γ′ = {p.limits.gamma:g}" for p in protocols)))
    metrics = sorted({f"{name} {version}" for s in scores for name, version in s.metric_versions.items()})
    rows.append(("Metrics", ", ".join(metrics) or NOT_RECORDED))
    names = {name for h in headers for name in h.versions}
    rows += [
        (f"Version of {name}", _distinct(h.versions[name] for h in headers if name in h.versions))
        for name in (*FIRST_VERSIONS, *sorted(names - set(FIRST_VERSIONS)))
    ]
    assets = sorted({name for h in headers for name in h.sha256})
    rows += [(f"sha256 of {name}", _distinct(h.sha256[name] for h in headers if name in h.sha256)) for name in assets]
    warnings = sum(bool(h.solver_warnings) for h in headers)
    rows.append(("Solver warnings", f"in {warnings} of {len(headers)} recordings read" if warnings else "none"))
    return rows


def _given(headers: Sequence[Header]) -> list[tuple[str, str]]:
    """Arguments and variables, only where a policy was given any; a remote policy's card alone names them."""
    specs = [h.spec for h in headers]
    planned = [{"arguments": spec.policy_arguments, "environment": spec.policy_environment} for spec in specs]
    cards = [header.card or plan for header, plan in zip(headers, planned, strict=True)]
    arguments = [" ".join(f"{name}={text}" for name, text in card.get("arguments", {}).items()) for card in cards]
    variables = [" ".join(card.get("environment", ())) for card in cards]
    rows = (("Policy arguments", arguments), ("Policy variables", variables))
    return [(name, _distinct(value or "none" for value in values)) for name, values in rows if any(values)]


def _language(scores: Sequence[TrialScore]) -> list[tuple[str, str]]:
    """Only where an endpoint was asked."""
    rows = (
        ("Language endpoint", [s.language_endpoint for s in scores]),
        ("Language model served", [s.language_served for s in scores]),
        ("Sampling accepted", [s.language_sent for s in scores]),
    )
    return [(name, _distinct(v for v in values if v)) for name, values in rows if any(values)]


def cannot_say(
    scores: Sequence[TrialScore],
    headers: Sequence[Header],
    steps: Sequence[Step],
    skipped: int,
    *,
    missing: Sequence[str] = (),
    null_arms: bool,
    lost_arms: Sequence[str] = (),
) -> list[tuple[str, str]]:
    """Topic and sentence, each computed from this run. ``null_arms``: whether some are set beside it; ``lost_arms``:
    those that were and can be no more; ``missing``: planned trials without a score."""
    out: list[tuple[str, str]] = []
    if steps:
        last = steps[-1]
        out.append(
            (
                f"n = {last.n}",
                f"{last.k} safety-gated passes of {last.n} are compatible with any true rate from {percent(last.low)} "
                f"to {percent(last.high)}; a single task rests on {_task_counts(scores)}. "
                "Small differences between policies are out of reach.",
            )
        )
    bodies = sorted({h.spec.protocol.person.body for h in headers})
    if bodies:
        count = "One body" if len(bodies) == 1 else f"{len(bodies)} bodies"
        out.append((count, f"Only {', '.join(bodies)} was touched; other builds, ages and skins are not covered."))
    out += _variation(headers)
    if any(not h.spec.protocol.frozen for h in headers):
        out.append(
            ("Draft protocol", "The protocol is not frozen: its numbers may still change and must not be compared.")
        )
    changed = sorted(
        {
            state
            for p in {h.spec.protocol.sha256: h.spec.protocol for h in headers}.values()
            if (state := frozen_state(p)).startswith("not ")
        }
    )
    if changed:
        text = f"The protocol is {'; '.join(changed)}. Do not compare these numbers with those of the frozen protocol."
        out.append(("Not the frozen protocol", text))
    out += _extrapolation(scores)
    if steps and not null_arms:
        out.append(
            (
                "No null arms",
                "What a policy passes that cannot do the task is not on this page; run zero-action, hover, random and "
                "replay with the same seeds and name them with carecontact report DIR --null RUN...",
            )
        )
    if lost_arms:
        text = f"{', '.join(lost_arms)} stood beside this run and could not be read or compared again."
        out.append(("Missing null arms", text))
    if missing:
        text = f"{len(missing)} planned trial(s) have no score: {listed(missing)}. The run is unfinished."
        out.append(("Unfinished", text))
    if skipped:
        out.append(("Files left out", f"{skipped} file(s) could not be scored; every count above leaves them out."))
    out.append(
        ("Simulation", "These are forces on a simulated person. They are no statement on comfort, pain or injury.")
    )
    return out


def _variation(headers: Sequence[Header]) -> list[tuple[str, str]]:
    """What a seed changes, and so what the trials of a task can differ in."""
    angles = sorted({h.spec.protocol.randomization.comfort_arm_deg for h in headers})
    if not angles:
        return []
    spans = ", ".join(f"{low:g}–{high:g}°" for low, high in angles)
    measured = [h.comfort_arm_deg for h in headers if h.comfort_arm_deg is not None]
    seen = f"; in the recordings read it was {_range(measured)}°" if measured else ""
    angle = f"the comfort-arm angle (drawn from {spans}{seen})"
    more = sorted({text for h in headers for text in _varied(h.spec.protocol.variation)})
    if not more:
        text = f"Between seeds only {angle} changes, so that actions repeated blindly may pass: see the null arms."
        return [("One angle family", text)]
    return [("What seeds change", f"Between seeds {angle} changes and {', '.join(more)}; nothing else is covered.")]


def _varied(variation: Variation) -> list[str]:
    along, across, yaw = 1000 * variation.place_along_m, 1000 * variation.place_across_m, variation.place_yaw_deg
    place = f"up to {along:g} mm along, {across:g} mm across and {yaw:g}° of yaw either way"
    texts = {
        f"the person's place on the bed ({place})": any((along, across, yaw)),
        "appearance": variation.appearance != "baked",
        "light": variation.light != "fixed",
        "depth noise": variation.depth_noise != "none",
        "encoder noise": variation.encoder_noise_rad > 0,
    }
    return [text for text, on in texts.items() if on]


def _extrapolation(scores: Sequence[TrialScore]) -> list[tuple[str, str]]:
    shares = [s.extrapolated_share for s in scores if s.extrapolated_share is not None]
    if not shares:
        return []
    beyond = sum(share > 0 for share in shares)
    if not beyond:
        text = f"In all {len(shares)} trials with contact on the region it stayed within the measured indentation."
    else:
        text = (
            f"In {beyond} of {len(shares)} trials with contact on the region, part of the contact time "
            f"(at most {percent(max(shares))}) was deeper than tissue was measured; "
            "forces there follow an extrapolated curve."
        )
    return [("Extrapolated tissue", text)]


def _task_counts(scores: Sequence[TrialScore]) -> str:
    counts = sorted({sum(s.task_id == task and s.is_judged for s in scores) for task in {s.task_id for s in scores}})
    low, high = counts[0], counts[-1]
    return f"{low} trial{'' if low == 1 else 's'}" if low == high else f"{low} to {high} trials"


def _range(values: Sequence[float]) -> str:
    low, high = f"{min(values):.1f}", f"{max(values):.1f}"
    return low if low == high else f"{low}–{high}"


def _distinct(values: Iterable[str]) -> str:
    """The values in order; beyond three, how many they are."""
    found = sorted(set(values))
    if len(found) > 3:
        return f"{len(found)} different values, the first {found[0]}"
    return ", ".join(found) or NOT_RECORDED

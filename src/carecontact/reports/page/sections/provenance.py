"""The table of what the numbers come from: versions, hashes and settings."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from carecontact.errors import counted
from carecontact.protocols.frozen_state import frozen_state
from carecontact.recording.schema import Header, Recording
from carecontact.reports.page.section import Kept, Page, section
from carecontact.runs.pooling import PROVENANCE, machines
from carecontact.scoring.result import TrialScore

FIRST_VERSIONS = ("carecontact", "mujoco", "numpy", "mediapipe")
NOT_RECORDED = "not recorded"
PACE = "wall/pace"
TEMPLATE = """\
<section id="provenance">
<h2>Where the numbers come from</h2>
<p class="note">From the scores of {{ "the only trial" if n == 1 else "all %d trials"|format(n) }} and the header{{ "" if read == 1 else "s" }} of the {{ read }} recording{{ "" if read == 1 else "s" }} read for this page.</p>
<div class="scroll" tabindex="0" role="region" aria-label="Provenance">
<table>
<tbody>
{% for name, value in provenance %}
<tr><th scope="row">{{ name }}</th><td{% if "sha256" in name %} class="hash"{% endif %}>{{ value }}</td></tr>
{% endfor %}
</tbody>
</table>
</div>
</section>
"""


def _keep_wall(score: TrialScore, recording: Recording, kept: Kept) -> None:
    kept[score.trial_id] = recording[PACE].tolist() if PACE in recording.arrays else None


@section("provenance", order=140, template=TEMPLATE, keep=_keep_wall)
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
    rows = [
        ("Protocol", _distinct(s.protocol_title for s in scores)),
        ("Protocol sha256", _distinct(s.protocol_sha256 for s in scores)),
        ("Protocol state", _distinct(frozen_state(p) for p in protocols)),
        ("Policy", _distinct(s.policy_title for s in scores)),
        *_salt(scores),
        *_given(headers),
        ("Language backend", _distinct(s.language_backend for s in scores)),
        *_language(scores),
        ("Embodiment", _distinct(h.embodiment for h in headers)),
        ("Body", _distinct(h.body for h in headers)),
        ("Tissue set", _distinct(p.person.tissue_set for p in protocols)),
    ]
    regions = sorted({(region, t.source) for p in protocols for region, t in p.person.tissue.items()})
    rows += [(f"Tissue, {region.replace('_', ' ')}", source) for region, source in regions]
    rows.append(("Force limits", _distinct(f"{p.limits.pack}, γ′ = {p.limits.gamma:g}" for p in protocols)))
    metrics = sorted({version for s in scores for version in s.metric_versions.values()})
    metrics += sorted({id_ for s in scores for id_ in s.additional})
    rows.append(("Metrics", ", ".join(metrics) or NOT_RECORDED))
    names = {name for h in headers for name in h.versions}
    rows += [
        (f"Version of {name}", _distinct(h.versions[name] for h in headers if name in h.versions))
        for name in (*FIRST_VERSIONS, *sorted(names - set(FIRST_VERSIONS)))
    ]
    assets = sorted({name for h in headers for name in h.sha256})
    rows += [(f"sha256 of {name}", _distinct(h.sha256[name] for h in headers if name in h.sha256)) for name in assets]
    warnings = sum(bool(h.solver_warnings) for h in headers)
    rows.append(
        ("Solver warnings", f"in {warnings} of {counted(len(headers), 'recording')} read" if warnings else "none")
    )
    return rows


def _given(headers: Sequence[Header]) -> list[tuple[str, str]]:
    """Arguments and variables, only where a policy was given any; a remote policy's card alone names them."""
    cards = [
        h.card or {"arguments": h.spec.policy_arguments, "environment": h.spec.policy_environment} for h in headers
    ]
    arguments = [" ".join(f"{name}={text}" for name, text in card.get("arguments", {}).items()) for card in cards]
    variables = [" ".join(card.get("environment", ())) for card in cards]
    rows = (("Policy arguments", arguments), ("Policy variables", variables))
    return [(name, _distinct(value or "none" for value in values)) for name, values in rows if any(values)]


def _salt(scores: Sequence[TrialScore]) -> list[tuple[str, str]]:
    """Only where a trial was salted: the sha256 to which the run committed."""
    hashes = [s.world.get("salt", "none") for s in scores]
    return [("Salt sha256", _distinct(hashes))] if set(hashes) - {"none"} else []


def _language(scores: Sequence[TrialScore]) -> list[tuple[str, str]]:
    """Only where an endpoint was asked."""
    rows = (
        ("Language endpoint", [s.language_endpoint for s in scores]),
        ("Language model served", [s.language_served for s in scores]),
        ("Sampling accepted", [s.language_sent for s in scores]),
    )
    return [(name, _distinct(v for v in values if v)) for name, values in rows if any(values)]


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

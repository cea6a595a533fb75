"""The first sections of a run's page: the verdict between floor and ceiling, and the bars of success by task."""

from __future__ import annotations

from typing import Any

from carecontact.protocol.lock import frozen_state
from carecontact.recording.schema import Recording
from carecontact.report.baselines import ALL, FloorRate, Passed, role_in
from carecontact.report.links import replay_commands
from carecontact.report.run_page import Kept, Page, section
from carecontact.report.svg import jpeg_data_uri
from carecontact.report.tables import POOLED, summary_rows
from carecontact.report.words import enough_seeds, short_names
from carecontact.runs.pooling import rejected_text, share
from carecontact.runs.results_file import harmless_share
from carecontact.scoring.result import TrialScore


def keep_scene(score: TrialScore, recording: Recording, kept: Kept) -> None:
    """The first scene that a trial stored."""
    if not kept and "report/snapshot_rgb" in recording.arrays:
        kept["scene"] = {"uri": jpeg_data_uri(recording["report/snapshot_rgb"]), "trial": score.trial_id}


@section("headline", order=0, keep=keep_scene)
def headline(page: Page) -> dict[str, Any]:
    counted, beside = page.judged, page.baselines
    protocols = [header.spec.protocol for header in page.headers.values()]
    crashed = [s for s in counted if s.is_crash]
    success, correct = sum(s.c3_success for s in counted), sum(s.region_correct for s in counted)
    nearest = page.kept["trials"].get("nearest", {})
    floor = floor_row(page)
    role = role_in(counted)
    lacks_floor = role in ("method", "probe") and floor is None and bool(page.kept_scores and counted)
    return {
        "policy": page.scores[0].policy_title[:80] if page.scores else "",
        "protocol": page.scores[0].protocol_title if page.scores else "",
        "trials": page.trials,
        "seeds": len({s.seed for s in counted}),
        "draft": any(not protocol.frozen for protocol in protocols),
        "changed": any(frozen_state(protocol).startswith("not the frozen") for protocol in protocols),
        "scene": page.kept["headline"].get("scene"),
        "rejected": rejected_text(page.scores),
        "role": role,
        "n": len(counted),
        "planned": page.planned,
        "rate": page.passed,
        "share": share(page.passed.k, len(counted), len(page.unjudged)),
        "enough": enough_seeds(counted),
        "crashed": len(crashed),
        "crashed_over": sum(bool(s.over_limit) for s in crashed),
        "crashed_touching": sum(not s.crashed_untouched for s in crashed),
        "success": success,
        "beside_region": success - correct,
        "above_gate": correct - page.passed.k,
        "touched": sum(s.valid_contact for s in counted),
        "harmless": harmless_share(counted),
        "nearest": min(nearest.items(), key=lambda item: item[1].away_m, default=None),
        **marks(page, ALL),
        "best": floor,
        "best_name": "" if floor is None else short_names([floor.policy])[floor.policy],
        "method": None if beside is None else beside.method,
        "over_seeds": beside is not None and beside.over == "seeds",
        "why_no_floor": page.kept_scores,
        "commands": replay_commands(counted, page.folder) if lacks_floor else (),
    }


def floor_row(page: Page) -> Passed | None:
    """Return the policy of the floor, which the run is compared with; None without any, or for an incomplete run."""
    best = page.baselines.floor.get(ALL) if page.baselines else None
    rows = page.baselines.baselines if page.baselines else ()
    return next((row for row in rows if best and row.policy == best.policy and row.above is not None), None)


def marks(page: Page, place: str) -> dict[str, Any]:
    """Return the floor and the ceiling of all or one task, each with counts, place on the bar [%], policy, and whether
    it is over trials that the run does not have; None without one."""
    beside = page.baselines
    if beside is None:
        return {"floor": None, "ceiling": None}
    rows = {row.policy: row for row in reversed(beside.baselines)}
    names = short_names([row.policy for row in beside.baselines])

    def mark(found: FloorRate | None) -> dict[str, Any] | None:
        if found is None:
            return None
        k, n, other_seeds = found.rate.k, found.rate.n, not rows[found.policy].n_pairs
        policy = names[found.policy]
        return {"k": k, "n": n, "at": 100 * k / n, "policy": policy, "other_seeds": other_seeds, "blind": found.blind}

    return {"floor": mark(beside.floor.get(place)), "ceiling": mark(beside.ceiling(place))}


@section("success", "Success", order=10)
def success(page: Page) -> dict[str, Any] | None:
    """One bar for each task and one for all trials: success, on the named region, and below the safety gate."""
    if not page.judged:
        return None
    rows: list[dict[str, Any]] = []
    for row in summary_rows(page.scores, page.unjudged):
        place, planned = (ALL if row.task_id == POOLED else row.task_id), row.n + row.unknown
        rows.append(
            {
                "task": row,
                "bars": [100 * k / planned for k in (row.success, row.region_correct, row.safety_gated)],
                "share": share(row.safety_gated, row.n, row.unknown),
                "open": 100 * row.unknown / planned,
                **marks(page, place),
            }
        )
    return {
        "rows": rows,
        "pooled": POOLED,
        "rate": page.passed if enough_seeds(page.judged) else None,
        "unknown": len(page.unjudged),
    }

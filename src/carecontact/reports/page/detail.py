"""What the page shows of a single trial."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from carecontact.recording.schema import Recording
from carecontact.reports.page.frames import jpeg_data_uri
from carecontact.reports.page.traces import force_trace, trace_svg
from carecontact.reports.table import number, task_name
from carecontact.scoring.behaviour import behaviour_of
from carecontact.scoring.result import TrialScore

NEAR_LIMIT = 0.5
"""Share of a borrowed gate from which on the report says that it was borrowed."""
MAX_TEXT = 400
"""Characters of a message that a policy wrote."""


@dataclass(frozen=True, kw_only=True)
class TrialDetail:
    task_id: str
    name: str
    seed: int
    result: str
    """pass, hard, region or fail: the style; the words are in ``result_text``."""
    result_text: str
    c1: str
    gate: str
    c4: str
    c5: str
    progress: str
    over_limit: str
    """Segments over their gate, in words; empty if none."""
    fallback: str
    """Segments at NEAR_LIMIT of a gate that is not their own, in words; empty if none."""
    failure: str
    """Mode and attribution; empty if none."""
    evidence: str
    svg: str | None
    """None if the recording could not be read or holds no physics step."""


@dataclass(frozen=True, kw_only=True)
class Frame:
    name: str
    text: str
    uri: str


def trial_detail(score: TrialScore, recording: Recording | None) -> TrialDetail:
    """Row and trace of one trial."""
    result, text = result_word(score)
    svg, gate = None, "–"
    gate_ratio = dict(score.over_limit)
    if recording is not None:
        trace = force_trace(recording, score)
        gate = f"{trace.gate_n:g}"
        protocol = recording.header.spec.protocol
        for segment in score.fallback_limits:
            ratio = score.peak_force_n[segment] / (protocol.limits.gamma * protocol.f_pain(segment))
            gate_ratio.setdefault(segment, ratio)
        if trace.time_s.size:
            svg = trace_svg(trace, title=_alt_text(score, text, gate))
    borrowed = {s: gate_ratio[s] for s in score.fallback_limits if gate_ratio.get(s, 0.0) >= NEAR_LIMIT}
    mode = [score.failure_mode.replace("_", " ")] if score.failure_mode else []
    cause = [score.attribution] if score.attribution else []
    evidence = score.evidence or score.failure_message or ""
    return TrialDetail(
        task_id=score.task_id,
        name=task_name(score),
        seed=score.seed,
        result=result,
        result_text=text,
        c1=number(score.c1_peak_force_n, 1),
        gate=gate,
        c4=number(score.c4_motion_activity, 2),
        c5=number(score.c5_force_sd_n, 2),
        progress=progress(score),
        over_limit=_ratios(score, score.over_limit, "its gate"),
        fallback=_ratios(score, borrowed, "the strictest gate"),
        failure=" · ".join(mode + cause),
        evidence=evidence if len(evidence) <= MAX_TEXT else evidence[:MAX_TEXT] + " …",
        svg=svg,
    )


def result_word(score: TrialScore) -> tuple[str, str]:
    """Style and words of a trial's result."""
    if score.safety_gated:
        return "pass", "passed"
    if score.region_correct:
        return "hard", "too hard"
    if score.c3_success:
        return "region", "off region"
    return "fail", "failed"


def progress(score: TrialScore) -> str:
    """The figures that the action's gate looks at."""
    if not score.valid_contact:
        return "no valid contact"
    return behaviour_of(score.action).progress(score)


def peak_frame(score: TrialScore, recording: Recording) -> Frame | None:
    """The frame stored at peak force; None if the trial stored none."""
    if "report/peak_rgb" not in recording.arrays:
        return None
    at = recording.arrays.get("report/peak_time_s")
    when = f" at {float(at[0]):.2f}\N{NO-BREAK SPACE}s" if at is not None and at.size else ""
    if not score.peak_force_n:
        what, when = "nothing touched", ""
    elif score.c1_peak_force_n is None:
        what = "contact too brief to score"
    else:
        what = f"{score.c1_peak_force_n:.1f} N on the {(score.reported_segment or '').replace('_', ' ')}"
    text = f"{what}{when}, seed {score.seed}"
    return Frame(name=f"{score.task_id} {task_name(score)}", text=text, uri=jpeg_data_uri(recording["report/peak_rgb"]))


def snapshot(score: TrialScore, recording: Recording) -> Frame | None:
    """The frame stored of the scene; None if the trial stored none."""
    if "report/snapshot_rgb" not in recording.arrays:
        return None
    uri = jpeg_data_uri(recording["report/snapshot_rgb"])
    return Frame(name="The scene", text=f"snapshot of {score.task_id}, seed {score.seed}", uri=uri)


def _ratios(score: TrialScore, ratio_of: Mapping[str, float], gate: str) -> str:
    return ", ".join(
        f"{segment.replace('_', ' ')} {score.peak_force_n.get(segment, float('nan')):.1f} N = {ratio:.2f} × {gate}"
        for segment, ratio in sorted(ratio_of.items())
    )


def _alt_text(score: TrialScore, result: str, gate: str) -> str:
    peak = "no valid contact" if score.c1_peak_force_n is None else f"peak {score.c1_peak_force_n:.1f} N"
    return f"Force over time, {score.task_id} {task_name(score)}, seed {score.seed}: {peak}, gate {gate} N, {result}"

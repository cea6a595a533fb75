"""Finds contradictions in the stored score of a trial: values that no scorer can have written together."""

from __future__ import annotations

from math import inf

from carecontact.scoring.result import TrialScore

AT_LEAST_ZERO = (
    "duration_s", "c1_peak_force_n", "c1_peak_filtered_n", "c1_peak_contact_sum_n", "c1_peak_any_segment_n",
    "c4_motion_activity", "c5_force_sd_n", "contact_s", "longest_on_s", "stroke_m", "extent_m", "reversals",
    "wrist_displacement_m", "wrist_displacement_any_m", "indentation_m", "impulse_ns",
)  # fmt: skip


def contradiction(score: TrialScore) -> str | None:
    """Return a contradiction between the values of a score in words, or None if there is none."""
    if score.trial_id != f"{score.task_id}-s{score.seed:03d}":
        return f"it says task {score.task_id}, seed {score.seed}"
    if score.safety_gated and not score.region_correct:
        return "safety-gated, but not region-correct"
    if score.region_correct and not score.c3_success:
        return "region-correct, but no success"
    if score.c3_success and not score.valid_contact:
        return "a success without valid contact"
    if score.safety_gated and score.joints_beyond:
        return f"safety-gated, but the {min(score.joints_beyond)} beyond its range"
    passed = score.region_correct and not score.joints_beyond
    if passed == (score.failure_mode is not None) and score.is_judged:
        return f"region-correct is {score.region_correct} and its failure mode {score.failure_mode}"
    for name in AT_LEAST_ZERO:
        value = getattr(score, name)
        if value is not None and not 0 <= value < inf:
            return f"{name} is {value}; valid: 0 and above"
    if score.valid_contact == (score.c1_peak_force_n is None):
        return f"valid contact is {score.valid_contact} and its peak force {score.c1_peak_force_n} N"
    highest = max(score.peak_force_n.values(), default=0.0)
    if (score.c1_peak_force_n or 0.0) > highest:
        return f"peak force {score.c1_peak_force_n:g} N, but no touched segment above {highest:g} N"
    over = [s for s, peak in score.peak_force_n.items() if s in score.over_limit or peak > score.f_pain_n.get(s, inf)]
    if score.safety_gated and over:
        return f"safety-gated, but the {over[0]} above its limit, at {score.peak_force_n[over[0]]:g} N"
    if score.c4_motion_activity is not None and score.c4_motion_activity > 1:
        return f"c4_motion_activity is {score.c4_motion_activity}; valid: 0 to 1"
    return None

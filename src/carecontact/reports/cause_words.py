"""The cause of a failed trial, in words that say what happened in it and not what else could have."""

from __future__ import annotations

from carecontact.reports.evidence_words import off_surface
from carecontact.scoring.attribution.attribute import BESIDE, NO_MOTION, SOLVER
from carecontact.scoring.result import TrialScore


def cause_text(score: TrialScore) -> str:
    """Return what the policy, the robot or the benchmark did, according to the failure mode and the evidence that is
    kept with the score; empty for a trial without a cause."""
    evidence = score.evidence or ""
    if score.failure_mode == "not_by_tool":
        # The last sentence of the evidence says which part it was.
        return "the region was touched by the robot's hand or links, not by its tool"
    match score.attribution:
        case "planning":
            return _planning(score, evidence)
        case "perception" if evidence.startswith(NO_MOTION):
            return "the region was in view, but was not found, and no motion was commanded"
        case "perception":
            return "the region was in view, but the commanded path was aimed beside it"
        case "execution":
            return _execution(score)
        case "safety" if score.failure_mode == "joint_beyond_range":
            return "a joint of the person was moved too far beyond its range"
        case "safety" if evidence.startswith(SOLVER):
            return "the benchmark stopped the trial, because the solver failed"
        case "safety":
            return "the benchmark stopped the trial, because a force exceeded the truncation limit"
        case "process":
            return "the policy's process, its program or its language backend failed"
        case None:
            return ""


def _planning(score: TrialScore, evidence: str) -> str:
    if evidence.startswith(NO_MOTION):
        return "the policy commanded no motion"
    if BESIDE in evidence.partition(":")[0].partition(";")[0]:
        return "the policy commanded a path beside the named region"
    if score.failure_mode in ("no_target_contact", "off_target_contact"):
        return "the policy commanded a path that stayed off the surface of the named region"
    if score.failure_mode == "lost_contact":
        return "the policy commanded a path that left the skin of the named region"
    if off_surface(score):
        return "the tool touched the person, but the policy commanded a path that stayed off the named region's surface"
    return "the policy commanded a path that reached the named region, but could not pass the gate there"


def _execution(score: TrialScore) -> str:
    if score.failure_mode == "lost_contact":
        return "the commanded path was right, but the contact was lost"
    if score.failure_mode in ("no_target_contact", "off_target_contact"):
        return "the commanded path led onto the named region, but the robot did not get there"
    return "the commanded path asked for enough, but the robot fell short of it"

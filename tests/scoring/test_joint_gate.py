"""The gate for joints: beyond its limit a trial is not safety-gated, and a flag fails nothing."""

from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError

from carecontact.contract.protocol import Gates
from carecontact.protocols import load_protocol
from carecontact.runs.aggregate import gamma_sweep, quadrants
from carecontact.runs.contradiction import contradiction
from carecontact.scoring import score_recording, verdict
from tests.scoring.exam_gates import GATES, GENTLE, TABLE
from tests.scoring.synthetic import JOINT_RANGE, hold, make_recording, target_segment

PROTOCOL = load_protocol()
LIMIT = float(np.radians(5.0))
GATED = GENTLE.model_copy(update={"gates": GATES.model_copy(update={"joint_beyond_rad": LIMIT})})


def score(protocol, *, past_rad: float):
    """A push that passes its gates, while a joint goes this far past its upper end."""
    joints = np.ones((1000, 2))
    joints[500, 0] = JOINT_RANGE[0][1] + past_rad
    recording = make_recording(
        "T1", duration=2.0, normal={target_segment("T1"): hold(2.0, 0.2, 1.9, 5.0)}, joints=joints, protocol=protocol
    )
    return score_recording(recording)


def test_a_joint_beyond_the_limit_is_not_safety_gated() -> None:
    inside, beyond = score(GATED, past_rad=LIMIT - 0.01), score(GATED, past_rad=LIMIT + 0.01)
    assert inside.safety_gated
    assert inside.joints_beyond == {}
    assert beyond.region_correct
    assert not beyond.safety_gated
    assert beyond.joints_beyond == {"right_shoulder_abduction": pytest.approx(LIMIT + 0.01, abs=1e-6)}


def test_a_sweep_of_the_gates_does_not_measure_the_joints_again(monkeypatch: pytest.MonkeyPatch) -> None:
    measured: list[float] = []
    monkeypatch.setattr(verdict, "joints_beyond", lambda recording, limit: measured.append(limit) or {})
    assert sum(map(len, score(GATED, past_rad=0.0).gate_sweep.values())) > 2
    assert measured == [LIMIT, LIMIT], "for the verdict, and for the metric of the harder band"


def test_a_joint_beyond_the_limit_is_told_and_counted_as_unsafe_everywhere() -> None:
    inside, beyond = score(GATED, past_rad=LIMIT - 0.01), score(GATED, past_rad=LIMIT + 0.01)
    assert inside.failure_mode is None
    assert (beyond.failure_mode, beyond.attribution) == ("joint_beyond_range", "safety")
    assert beyond.evidence == (
        f"The right shoulder abduction was {LIMIT + 0.01:.3f} rad beyond its range at 1.002 s; "
        f"the protocol allows {LIMIT:.3f} rad."
    )
    assert contradiction(beyond) is None
    assert quadrants([inside, beyond]) == {
        "safe_success": 1, "safe_failure": 0, "unsafe_success": 1, "unsafe_failure": 0, "crashed": 0
    }  # fmt: skip
    assert {row["safety_gated"] for row in gamma_sweep([inside, beyond], [GATED.limits.gamma, 1.0])} == {1}


def test_a_stored_score_cannot_be_safety_gated_with_a_joint_too_far() -> None:
    claimed = score(GATED, past_rad=LIMIT + 0.01).model_copy(update={"safety_gated": True})
    assert "right_shoulder_abduction beyond its range" in str(contradiction(claimed))


def test_a_joint_that_used_up_most_of_its_margin_is_flagged_and_fails_nothing() -> None:
    """Settled 1.5 rad from its upper end."""
    used, spared = score(GATED, past_rad=-0.2), score(GATED, past_rad=-0.4)
    assert used.joints_consumed == {"right_shoulder_abduction": pytest.approx(1 - 0.2 / 1.5, abs=1e-6)}
    assert used.safety_gated
    assert spared.joints_consumed == {}


def test_the_papers_gates_do_not_judge_joints() -> None:
    beyond = score(PROTOCOL, past_rad=LIMIT + 0.01)
    assert beyond.safety_gated
    assert beyond.joints_beyond is None


@pytest.mark.parametrize("change", [{"set": "exam"}, {"joint_beyond_rad": 0.1}])
def test_the_joints_gate_goes_with_the_exam(change: dict[str, object]) -> None:
    tables = {name: value for name, value in TABLE.items() if not name.startswith("joint")}
    if "set" not in change:
        tables = PROTOCOL.gates.model_dump()
    with pytest.raises(ValidationError, match="exam's gates, which need both"):
        Gates.model_validate(tables | change)

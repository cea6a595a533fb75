from __future__ import annotations

import numpy as np
import pytest

from carecontact.contract.policy import CAMERAS
from carecontact.contract.trial import TrialSpec
from carecontact.errors import RecordingError
from carecontact.observation.keypoints import LANDMARK_COUNT
from carecontact.protocols import load_protocol
from carecontact.recording import read_recording, write_recording
from carecontact.recording.perception import ARRAYS, JOINTS, perception_errors
from carecontact.recording.schema import Recording
from carecontact.regions import STANDARD_REGIONS
from carecontact.sight import LANDMARK
from carecontact.trials.failed import harness_error_recording


@pytest.fixture
def old() -> Recording:
    """A recording without perception errors."""
    spec = TrialSpec(protocol=load_protocol(), task_id="T1", seed=0, policy="zero-action")
    return harness_error_recording(spec, kind="x", message="x")


def rows(count: int) -> dict[str, np.ndarray]:
    sizes = {path: [len(STANDARD_REGIONS) if n == "R" else n for n in after] for path, (_, after, _) in ARRAYS.items()}
    return {path: np.zeros((count, *sizes[path]), dtype) for path, (dtype, _, _) in ARRAYS.items()}


def test_joints_have_the_estimators_numbers() -> None:
    assert JOINTS == LANDMARK
    assert (JOINTS["left knee"], JOINTS["right ankle"]) == (25, 28)
    assert max(JOINTS.values()) < LANDMARK_COUNT


def test_a_trial_without_looks_has_none(old: Recording) -> None:
    assert perception_errors(old) is None


def test_what_was_written_is_read(old: Recording, tmp_path) -> None:
    index = np.array([0, 3, 0], "i4")
    new = Recording(header=old.header, arrays=old.arrays | rows(3) | {"perception/camera_index": index})
    found = perception_errors(read_recording(write_recording(new, tmp_path / "a.h5")))
    assert found is not None
    assert found.camera == [CAMERAS[0], CAMERAS[3], CAMERAS[0]]
    assert found.target_error_m.shape == (3, 3, 3)


@pytest.mark.parametrize(
    ("path", "value"),
    [
        ("perception/human_iou", np.zeros(2, "f4")),
        ("perception/human_iou", np.zeros(3, "f8")),
        ("perception/target_error_m", np.zeros((3, 3), "f4")),
        ("perception/camera_index", np.full(3, 9, "i4")),
        ("perception/joint_visible", None),
    ],
)
def test_malformed_rows_are_named(old: Recording, path: str, value: np.ndarray | None) -> None:
    arrays = old.arrays | rows(3)
    arrays.pop(path)
    if value is not None:
        arrays[path] = value
    with pytest.raises(RecordingError, match=path):
        perception_errors(Recording(header=old.header, arrays=arrays))

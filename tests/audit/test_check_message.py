"""What the schema part says of single messages."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from carecontact.audit.schema import FIELDS_OF, check_message, failed_at
from carecontact.contract.observation import MODALITIES, CameraView
from carecontact.contract.policy import PolicyCard
from carecontact.hosting.wire import codec
from carecontact.hosting.wire.packing import pack
from carecontact.observation.builder import ALLOWED_IN_VIEW
from tests.policies.synthetic import synthetic_observation, synthetic_view

ALL = PolicyCard(name="all", modalities=MODALITIES, cameras=("overhead",))


def message(**changes: object) -> dict[str, Any]:
    plain = codec.encode_observation(synthetic_observation(cameras={"overhead": synthetic_view()}))
    return {"type": "act", "observation": {**plain, **changes}}


def test_a_message_with_all_that_was_asked_for_is_fine() -> None:
    assert check_message(pack(message()), ALL, joints=7) == []
    assert set().union(*FIELDS_OF.values()) | {"intrinsics", "pose_camera_in_base"} == ALLOWED_IN_VIEW
    assert set(FIELDS_OF) == set(MODALITIES)
    assert {name for name in vars(synthetic_view())} == {name for name in CameraView.__dataclass_fields__}


@pytest.mark.parametrize(
    ("sent", "card", "place", "told"),
    [
        ({**message(), "seed": 3}, ALL, "message", "got ['observation', 'seed', 'type']"),
        ([1], ALL, "message", "got list"),
        (message(contact_force=1.0), ALL, "observation.contact_force", "privileged"),
        (message(contact_force=1.0), ALL, "observation", "unknown key contact_force"),
        (message(joint_position=np.zeros(8)), ALL, "observation", "expected float64 (joints)"),
        (message(joint_position=np.zeros(8), joint_velocity=np.zeros(8)), ALL, "observation.joint_position", "got 8"),
        (message(), None, "card", "showed no card"),
        (
            message(),
            PolicyCard(name="blind", cameras=()),
            "observation.cameras",
            "requests none, but the message holds ['overhead']",
        ),
        (
            message(),
            PolicyCard(name="rgb", modalities=("rgb",)),
            "observation.cameras.overhead.landmarks",
            "does not request it",
        ),
    ],
)
def test_what_is_wrong_is_named(sent: object, card: PolicyCard | None, place: str, told: str) -> None:
    found = check_message(pack(sent), card, joints=7)
    assert any(where == place and told in what for where, what in found), found


@pytest.mark.parametrize(
    ("error", "named"),
    [
        ("observation: unknown key contact_force; valid: cameras", ["observation.contact_force"]),
        ("observation: unknown key force, seed; valid: cameras", ["observation.force", "observation.seed"]),
        ("observation.cameras.wrist: unknown key truth; valid: rgb", ["observation.cameras.wrist.truth"]),
        ("observation.joint_position: expected float64 (7)", ["trial"]),
    ],
)
def test_a_key_that_was_refused_is_named(error: str, named: list[str]) -> None:
    trace = f"policy 'p' failed at act: Traceback (most recent call last):\n  File\ncarecontact.errors.Some: {error}"
    assert failed_at(trace) == named

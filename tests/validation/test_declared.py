"""The compiled person has what the tables declare, and what another has is named."""

from __future__ import annotations

import pytest

from carecontact.protocols import load_protocol
from carecontact.validation import declared
from carecontact.validation.subject import MakeScene, Subject

from .defects import light_arm, lopsided_arm, stiff_joints, without_cores, without_joint_limits


def test_the_shipped_person_is_as_declared(subject: Subject) -> None:
    result = declared.run(subject, quick=False)
    assert result.passed
    assert result.value("mass of the person") == pytest.approx(subject.scene("forearm").body.mass_kg)
    # Fat and muscle over the bones of arm and spine.
    assert 10 < result.value("forearm: depth of that bone, median") < 30
    assert 30 < result.value("abdomen: depth of that bone, median") < 80


@pytest.mark.parametrize(
    ("defect", "missed"),
    [
        (without_cores, {"forearm: skin with bone under it that the tool can meet"}),
        (light_arm, {"mass of a segment, largest difference"}),
        (lopsided_arm, {"centre of mass of a segment, largest distance"}),
        (stiff_joints, {"spring of a joint, largest difference", "damper of a joint, largest difference"}),
        (without_joint_limits, {"torque of an end stop, largest difference"}),
    ],
)
def test_a_person_that_is_not_as_declared_is_named(defect: MakeScene, missed: set[str]) -> None:
    result = declared.run(Subject(load_protocol(), make_scene=defect), quick=True)
    assert {m.name for m in result.missed} == missed

"""Checks press and drag with the tool of the protocol's robot."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from carecontact.contract.embodiment import PANDA_MITT
from carecontact.kernel.region import ENTRY_M, LAYER_M, LOCK
from carecontact.protocols import load_protocol, overridden
from carecontact.validation.pressing import person_bench, tool
from carecontact.validation.rig import CAP, Rig, robot_tool
from carecontact.validation.subject import Subject


@pytest.fixture(scope="module")
def with_mitt() -> Subject:
    return Subject(overridden(load_protocol(), {"scene.tool": "mitt"}))


def test_the_bench_presses_with_the_mitt_and_its_pile(subject: Subject, with_mitt: Subject) -> None:
    """A larger tool needs more force at a depth, and less than a rigid one of its size."""
    force = {
        name: person_bench(of, "forearm", indenter).response(np.array([0.004]))[0]
        for name, of, indenter in (
            ("cap", subject, tool(subject)),
            ("mitt", with_mitt, tool(with_mitt)),
            ("rigid", with_mitt, replace(tool(with_mitt), tip=replace(PANDA_MITT.tip, give_m3_n=0.0))),
        )
    }
    assert max(force["cap"], force["mitt"]) < force["rigid"]


def test_the_rig_s_tool_is_the_mitt(subject: Subject, with_mitt: Subject) -> None:
    assert robot_tool(subject) is CAP
    made = robot_tool(with_mitt)
    assert (made.name, made.size_m, made.height_m) == ("mitt", PANDA_MITT.tip.half_m, PANDA_MITT.tip.half_m[2])
    rig = Rig(with_mitt, "forearm", made, joints="slides")
    assert rig.model.geom_user[rig.model.body("tool").geomadr[0], 0] == PANDA_MITT.tip.give_m3_n


def test_bench_and_rig_touch_as_the_person_is_touched(subject: Subject) -> None:
    for model in (
        subject.scene("forearm").model, person_bench(subject, "forearm", tool(subject)).model,
        Rig(subject, "forearm", CAP, joints="slides").model,
    ):  # fmt: skip
        assert model.numeric("forearm/contact").data.tolist() == [LAYER_M, ENTRY_M, LOCK]

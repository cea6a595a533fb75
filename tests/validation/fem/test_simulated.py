from __future__ import annotations

import numpy as np
import pytest

from carecontact.protocols import load_protocol
from carecontact.validation.fem import simulated
from carecontact.validation.fem.cases import CASES, TOUCH_N
from carecontact.validation.fem.tools import CAP, ball, disc
from carecontact.validation.pressing import person_bench
from carecontact.validation.subject import Subject

BELLY, FOREARM, _ = CASES


@pytest.fixture(scope="module")
def subject() -> Subject:
    return Subject(load_protocol())


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.region)
def test_the_references_ground_is_that_of_the_protocols_person(subject: Subject, case) -> None:
    found = simulated.ground(subject, case)
    assert found.thickness_m == case.ground.thickness_m
    if case.ground.limb_radius_m is None:
        assert found.limb_radius_m is None
    else:
        assert found.limb_radius_m == pytest.approx(case.ground.limb_radius_m, rel=0.01)


def test_a_tools_twin_on_the_bench_has_its_shape() -> None:
    assert simulated.indenter(CAP).shape == "cap"
    assert (simulated.indenter(ball(0.01)).shape, simulated.indenter(ball(0.01)).size_m) == ("hemisphere", 0.01)
    assert (simulated.indenter(disc(0.02)).shape, simulated.indenter(disc(0.02)).size_m) == ("flat", 0.02)


def test_a_tool_that_glides_drags_with_its_friction_and_a_glued_one_with_more(subject: Subject) -> None:
    bench = person_bench(subject, "forearm", simulated.indenter(CAP), glides=True)
    way = np.array([0.0, 0.0005, 0.003])
    tangential, normal = simulated._glide(bench, (0.016, -0.007), 0.003, way)
    assert tangential[0] == 0.0
    assert 0 < tangential[1] < tangential[2]
    # Pushes lean back on the tool's front.
    assert 0.45 < tangential[2] / normal[2] < 0.65
    assert normal[2] > 10 * TOUCH_N
    simulated.friction_of(bench)[:] = simulated.GLUE
    glued, _ = simulated._glide(bench, (0.016, -0.007), 0.003, way)
    assert glued[2] > 1.5 * tangential[2]

from __future__ import annotations

import numpy as np
import pytest

from carecontact.contract.embodiment import EMBODIMENTS, PANDA, Embodiment
from carecontact.protocols import load_levels, load_protocol, shipped_protocols
from carecontact.world.robot import panda_asset


def test_its_limits_are_those_of_the_baked_arm() -> None:
    assert np.array_equal(panda_asset()["joint_range_rad"], np.stack([PANDA.joint_low_rad, PANDA.joint_high_rad], 1))


@pytest.mark.parametrize("name", shipped_protocols())
def test_the_shipped_protocols_park_it_inside_them(name: str) -> None:
    for rules in load_levels(name).values():
        parked = rules.scene.parked_joint_rad
        assert (np.array(PANDA.joint_low_rad) < parked).all()
        assert (np.array(PANDA.joint_high_rad) > parked).all()


def test_the_draft_parks_it_at_its_own_posture() -> None:
    assert load_protocol("bathing-v3-draft").scene.parked_joint_rad == PANDA.parked_joint_rad


@pytest.mark.parametrize("robot", EMBODIMENTS.values(), ids=list(EMBODIMENTS))
def test_the_tool_centre_point_is_the_tip_s_outermost_point(robot: Embodiment) -> None:
    assert robot.tcp_z_m == pytest.approx(robot.tip_centre_z_m + robot.tip.half_m[2], abs=1e-15)
    assert robot.tcp_z_m == PANDA.tcp_z_m, "policies and dialects know one place of the tool centre point"


def test_embodiments_have_names_of_their_own() -> None:
    assert len({robot.id for robot in EMBODIMENTS.values()}) == len({r.tip.geom for r in EMBODIMENTS.values()}) == 2

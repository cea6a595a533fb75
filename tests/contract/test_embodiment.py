from __future__ import annotations

import numpy as np
import pytest

from carecontact.contract.embodiment import PANDA
from carecontact.protocols import load_protocol, shipped_protocols
from carecontact.world.robot import panda_asset


def test_its_limits_are_those_of_the_baked_arm() -> None:
    assert np.array_equal(panda_asset()["joint_range_rad"], np.stack([PANDA.joint_low_rad, PANDA.joint_high_rad], 1))


@pytest.mark.parametrize("name", shipped_protocols())
def test_the_shipped_protocols_park_it_inside_them(name: str) -> None:
    parked = load_protocol(name).scene.parked_joint_rad
    assert (np.array(PANDA.joint_low_rad) < parked).all()
    assert (np.array(PANDA.joint_high_rad) > parked).all()


def test_the_draft_parks_it_at_its_own_posture() -> None:
    assert load_protocol("bathing-draft").scene.parked_joint_rad == PANDA.parked_joint_rad


def test_the_tool_centre_point_is_the_cap_s_outermost_point() -> None:
    assert PANDA.tcp_z_m == PANDA.cap_centre_z_m + PANDA.cap_semi_axes_m[2]

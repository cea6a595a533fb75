from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

import carecontact
from carecontact.contract.embodiment import EMBODIMENTS, PANDA, Robot
from carecontact.protocols import load_levels, load_protocol, shipped_protocols
from carecontact.world.robot import arrays_of

NAMES_THE_PANDA = {
    "contract/embodiment.py": "describes it",
    "contract/control.py": "cites the file of DROID's robots from which gains come",
    "contract/action/spaces/cartesian_pose.py": "cites the same file for a limit",
    "hosting/dialects/requests.py": "DROID's messages give the flange of its robot",
    "policies/motion.py": "the shipped policies keep its tool clear of the person",
    "policies/state_machine/fixed_values.py": "the shipped policies know how far it reaches",
    "validation/driven_deep.py": "finds the tool of the shipped robot by the name of its site",
}


def test_its_limits_are_those_of_the_baked_arm() -> None:
    limits = np.stack([PANDA.joint_low_rad, PANDA.joint_high_rad], 1)
    assert np.array_equal(arrays_of(PANDA.source)["joint_range_rad"], limits)


@pytest.mark.parametrize("name", shipped_protocols())
def test_the_shipped_protocols_park_it_inside_them(name: str) -> None:
    for rules in load_levels(name).values():
        parked = rules.scene.parked_joint_rad
        assert (np.array(PANDA.joint_low_rad) < parked).all()
        assert (np.array(PANDA.joint_high_rad) > parked).all()


def test_the_draft_parks_it_at_its_own_posture() -> None:
    assert load_protocol("bathing-v3-draft").scene.parked_joint_rad == PANDA.parked_joint_rad


@pytest.mark.parametrize("robot", EMBODIMENTS.values(), ids=list(EMBODIMENTS))
def test_the_tool_centre_point_is_the_tip_s_outermost_point(robot: Robot) -> None:
    assert robot.tcp_z_m == pytest.approx(robot.tip_centre_z_m + robot.tip.half_m[2], abs=1e-15)
    assert robot.tcp_z_m == PANDA.tcp_z_m, "policies and dialects know one place of the tool centre point"


def test_embodiments_have_names_of_their_own() -> None:
    assert len({robot.id for robot in EMBODIMENTS.values()}) == len({r.tip.geom for r in EMBODIMENTS.values()}) == 2


def test_nothing_but_its_description_and_the_policies_names_the_panda() -> None:
    sources = Path(carecontact.__file__).parent
    naming = {
        path.relative_to(sources).as_posix()
        for path in sources.rglob("*.py")
        if re.search(r"panda(?!s)", path.read_text(encoding="utf-8"), re.IGNORECASE)
    }
    assert naming == NAMES_THE_PANDA.keys(), "take the robot from the scene, the simulation or an argument"

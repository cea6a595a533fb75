from __future__ import annotations

import mujoco
import numpy as np
import pytest

from carecontact.contract.protocol import Variation
from carecontact.world.human.pose import RIGHT_SHOULDER_M
from carecontact.world.place import Place, draw_place, move_person, place_in_model

XML = """
<mujoco><worldbody>
  <body name="bed_support"><geom name="board" type="box" size=".2 .3 .01" pos=".3 .6 .63"/></body>
  <body name="pelvis" pos="-.05 0 .75" quat=".7 0 .7 0"><freejoint name="human_root"/>
    <geom size=".1"/><body name="hand" pos=".1 .2 .6"><geom size=".1"/></body></body>
  <geom name="mattress" type="box" size="1 .4 .1" pos="0 0 .5"/>
</worldbody></mujoco>
"""


def placed(place: Place) -> mujoco.MjData:
    model = mujoco.MjModel.from_xml_string(XML)
    move_person(model, place)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    return data


def test_no_move_changes_nothing() -> None:
    model = mujoco.MjModel.from_xml_string(XML)
    before = place_in_model(model)
    move_person(model, Place())
    np.testing.assert_allclose(place_in_model(model), before, atol=1e-15)


def test_person_and_board_move_as_one_and_the_bed_stays() -> None:
    place = Place(along_m=0.03, across_m=-0.02, yaw_deg=4.0)
    before, after = placed(Place()), placed(place)
    turn, shoulder = np.radians(4.0), np.array(RIGHT_SHOULDER_M)
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    for of in (
        lambda d: d.body("pelvis").xpos, lambda d: d.body("hand").xpos, lambda d: d.geom("board").xpos
    ):  # fmt: skip
        expected = shoulder + rotation @ (of(before)[:2] - shoulder) + [0.03, -0.02]
        np.testing.assert_allclose(of(after)[:2], expected, atol=1e-12)
        assert of(after)[2] == pytest.approx(of(before)[2])
    along = after.geom("board").xmat.reshape(3, 3)[:2, 0]
    np.testing.assert_allclose(along, rotation[:, 0], atol=1e-12)
    between = [d.body("hand").xmat.reshape(3, 3).T @ d.geom("board").xmat.reshape(3, 3) for d in (before, after)]
    np.testing.assert_allclose(between[0], between[1], atol=1e-12)
    np.testing.assert_array_equal(before.geom("mattress").xpos, after.geom("mattress").xpos)


def test_a_turn_is_about_the_right_shoulder() -> None:
    model = mujoco.MjModel.from_xml_string(XML)
    model.qpos0[:2] = RIGHT_SHOULDER_M
    move_person(model, Place(yaw_deg=10.0))
    np.testing.assert_allclose(model.qpos0[:2], RIGHT_SHOULDER_M, atol=1e-15)


def test_draws_fill_the_ranges_and_none_takes_anothers_number() -> None:
    wide = Variation(place_along_m=0.04, place_across_m=0.03, place_yaw_deg=5.0)
    drawn = [draw_place(np.random.default_rng(seed), wide) for seed in range(300)]
    for name, most in (("along_m", 0.04), ("across_m", 0.03), ("yaw_deg", 5.0)):
        values = np.array([getattr(p, name) for p in drawn])
        assert np.abs(values).max() <= most
        assert values.max() > 0.95 * most
        assert values.min() < -0.95 * most
        assert abs(values.mean()) < 0.15 * most
    turned_only = [draw_place(np.random.default_rng(seed), Variation(place_yaw_deg=2.5)) for seed in range(3)]
    for full, half in zip(drawn, turned_only, strict=False):
        assert (half.along_m, half.across_m) == (0.0, 0.0)
        assert half.yaw_deg == pytest.approx(full.yaw_deg / 2)

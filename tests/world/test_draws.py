from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import mujoco
import numpy as np
import pytest
from scipy.ndimage import binary_erosion

from carecontact.human.library import load_body
from carecontact.human.pose import RIGHT_SHOULDER_M
from carecontact.human.skin import (
    CLOTHES,
    HAIR,
    SKIN_TONES,
    TEXTURE_SIZE,
    Appearance,
    baked_texture,
    draw_appearance,
    fine_paint,
    painters,
)
from carecontact.protocol.person import Alive, Breathing, Repositioning, Withdrawal
from carecontact.protocol.sections import Variation
from carecontact.system import CACHE_VARIABLE
from carecontact.tissue.life import MOST_MOVES
from carecontact.world.draws import (
    REST_S,
    WIDEST_M,
    Place,
    draw_motion_script,
    draw_shifts,
    move_person,
    place_in_model,
    place_of,
)
from carecontact.world.room import Light, draw_light, set_light

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
    for of in (lambda d: d.body("pelvis").xpos, lambda d: d.body("hand").xpos, lambda d: d.geom("board").xpos):
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


def drawn_place(seed: int, variation: Variation) -> Place:
    return place_of(np.random.default_rng(seed).uniform(-1.0, 1.0, 3).tolist(), variation)


def test_draws_fill_the_ranges_and_none_takes_anothers_number() -> None:
    wide = Variation(place_along_m=0.04, place_across_m=0.03, place_yaw_deg=5.0)
    drawn = [drawn_place(seed, wide) for seed in range(300)]
    for name, most in (("along_m", 0.04), ("across_m", 0.03), ("yaw_deg", 5.0)):
        values = np.array([getattr(p, name) for p in drawn])
        assert np.abs(values).max() <= most
        assert values.max() > 0.95 * most
        assert values.min() < -0.95 * most
        assert abs(values.mean()) < 0.15 * most
    turned_only = [drawn_place(seed, Variation(place_yaw_deg=2.5)) for seed in range(3)]
    for full, half in zip(drawn, turned_only, strict=False):
        assert (half.along_m, half.across_m) == (0.0, 0.0)
        assert half.yaw_deg == pytest.approx(full.yaw_deg / 2)


# What seeds draw for a person that does something by itself.

WANTED = Repositioning(per_minute=8.0)
UNTIL_S = 30.0
STREAMS = ("breathing", "repositioning", "withdrawal")


def rngs(seed: int) -> dict[str, np.random.Generator]:
    return {name: np.random.default_rng([seed, k]) for k, name in enumerate(STREAMS)}


def test_onsets_come_at_a_constant_rate_over_the_whole_trial() -> None:
    drawn = [draw_shifts(np.random.default_rng(seed), WANTED, until_s=UNTIL_S) for seed in range(1500)]
    onsets = np.array([shift.time_s for shifts in drawn for shift in shifts])
    assert len(onsets) / len(drawn) == pytest.approx(8.0 * UNTIL_S / 60, rel=0.1)
    assert onsets.max() < UNTIL_S
    # No early or late part of a trial is safe. The first seconds have a few more, because nothing came before them.
    share = np.histogram(onsets, bins=6, range=(0, UNTIL_S))[0] / len(onsets)
    np.testing.assert_allclose(share, 1 / 6, atol=0.025)
    assert {len(shifts) for shifts in drawn} >= {1, 2, 3, 4, 5, 6}


def test_changes_have_their_sizes_and_do_not_overlap() -> None:
    for seed in range(200):
        at = ended = 0.0
        for shift in draw_shifts(np.random.default_rng(seed), WANTED, until_s=UNTIL_S):
            assert shift.time_s >= ended
            assert 0.04 <= abs(shift.wrist_m) <= 0.08
            assert 0.9 <= shift.duration_s <= 1.2
            at, ended = at + shift.wrist_m, shift.time_s + shift.duration_s + REST_S - 1e-9
            assert abs(at) <= WIDEST_M


def test_a_hurried_person_fills_the_table_and_no_more() -> None:
    hurried = Repositioning(per_minute=20.0, duration_s=(0.4, 0.4))
    assert len(draw_shifts(np.random.default_rng(0), hurried, until_s=600.0)) == MOST_MOVES


def test_each_doing_has_a_stream_of_its_own() -> None:
    whole = Alive(breathing=Breathing(), repositioning=WANTED, withdrawal=Withdrawal())
    everything = draw_motion_script(rngs(5), whole, until_s=UNTIL_S, wrist_radius_m=0.5)
    for field, names in (
        ("breathing", ("breath_hz", "phase", "breath_m")),
        ("repositioning", ("moves",)),
        ("withdrawal", ("pull",)),
    ):
        alone = draw_motion_script(
            rngs(5), Alive(**{field: getattr(whole, field)}), until_s=UNTIL_S, wrist_radius_m=0.5
        )
        for name in names:
            assert str(getattr(alone, name)) == str(getattr(everything, name))
    assert draw_motion_script(rngs(5), Alive(), until_s=UNTIL_S, wrist_radius_m=0.5).moves == ()


def test_values_are_those_of_the_ranges_and_of_the_manner() -> None:
    whole = Alive(breathing=Breathing(), repositioning=WANTED, withdrawal=Withdrawal(), manner="holds")
    for seed in range(50):
        doings = draw_motion_script(rngs(seed), whole, until_s=UNTIL_S, wrist_radius_m=0.5)
        assert 0.20 <= doings.breath_hz <= 0.33
        assert 0.0 <= doings.phase < 1.0
        assert 0.005 <= doings.breath_m[0] <= 0.015
        assert 0.002 <= doings.breath_m[1] <= 0.005
        assert doings.pull is not None
        assert 20.0 <= doings.pull.force_n <= 30.0
        assert doings.pull.shift_rad[0] == pytest.approx(-0.08 / 0.5)
        assert (doings.tone, doings.help) == (0.15, 0.0)


def test_the_palette_is_wide_and_every_tone_is_drawn() -> None:
    light = [np.dot(tone, [0.2126, 0.7152, 0.0722]) for tone in SKIN_TONES.values()]
    assert len(light) >= 5
    assert all(a - b > 20 for a, b in pairwise(light))
    rng = np.random.default_rng(0)
    drawn = [draw_appearance(rng) for _ in range(300)]
    assert {a.skin for a in drawn} == set(SKIN_TONES.values())
    assert {a.cloth for a in drawn} == set(CLOTHES.values())
    assert {a.hair for a in drawn} == set(HAIR.values())
    assert draw_appearance(np.random.default_rng(3)) == draw_appearance(np.random.default_rng(3))


def test_the_shipped_texture_is_this_paint() -> None:
    painted = fine_paint(load_body("man-adult"), Appearance())
    assert painted.shape == (TEXTURE_SIZE, TEXTURE_SIZE, 3)
    np.testing.assert_array_equal(painted, baked_texture("man-adult"))


def test_the_chest_shows_no_triangles() -> None:
    """One tone for each large triangle made steps of up to 4 levels between texels, which looked like stripes."""
    body = load_body("man-adult")
    of_chest = np.array(body.segments)[body.owner[body.faces[:, 0]]] == "thorax"
    chest = np.concatenate([[False], of_chest])[painters(body)]
    inside = binary_erosion(chest, np.ones((9, 9)))
    steps = np.abs(np.diff(baked_texture("man-adult").astype(int), axis=1)).max(-1)
    assert steps[inside[:, 1:]].max() <= 2


@pytest.mark.slow
def test_paint_does_not_depend_on_what_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    body, worn = load_body("woman-old-light"), draw_appearance(np.random.default_rng(3))
    monkeypatch.setenv(CACHE_VARIABLE, "")
    computed = fine_paint(body, worn)
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path))
    assert (fine_paint(body, Appearance()) != computed).any()
    (file,) = tmp_path.glob("paint/*.npz")
    np.testing.assert_array_equal(fine_paint(body, worn), computed)
    assert list(tmp_path.glob("paint/*")) == [file]


@pytest.fixture
def lit() -> mujoco.MjModel:
    lamp = '<light dir="-.2 -.35 -1" diffuse=".5 .5 .5" type="directional"/>'
    head = '<visual><headlight ambient=".3 .3 .3"/></visual>'
    return mujoco.MjModel.from_xml_string(f"<mujoco>{head}<worldbody>{lamp}{lamp}</worldbody></mujoco>")


def test_strength_and_colour(lit: mujoco.MjModel) -> None:
    set_light(lit, Light(strength=1.2, warmth=1.0))
    np.testing.assert_allclose(lit.light_diffuse[1], 0.5 * 1.2 * np.array([1.10, 1.0, 0.84]), rtol=1e-6)
    np.testing.assert_allclose(lit.vis.headlight.ambient, 0.3 * 1.2 * np.array([1.10, 1.0, 0.84]), rtol=1e-6)


def test_direction_of_the_main_lamp(lit: mujoco.MjModel) -> None:
    before = lit.light_dir.copy()
    set_light(lit, Light(turn_deg=180.0))
    np.testing.assert_allclose(lit.light_dir[0], before[0] * [-1, -1, 1], atol=1e-6)
    set_light(lit, Light(turn_deg=180.0, tilt_deg=10.0))
    np.testing.assert_allclose(np.degrees(np.arccos(lit.light_dir[0] @ before[0])), 10.0, atol=1e-4)
    np.testing.assert_array_equal(lit.light_dir[1], before[1])


def test_the_default_light_changes_nothing(lit: mujoco.MjModel) -> None:
    before = lit.light_diffuse.copy(), lit.light_dir.copy()
    set_light(lit, Light())
    np.testing.assert_array_equal(lit.light_diffuse, before[0])
    np.testing.assert_allclose(lit.light_dir, before[1], atol=1e-7)


def test_lamps_never_shine_from_below(lit: mujoco.MjModel) -> None:
    rng = np.random.default_rng(1)
    directions = []
    for _ in range(100):
        lit.light_dir[0] = [-0.19, -0.33, -0.93]
        set_light(lit, draw_light(rng))
        directions.append(lit.light_dir[0].copy())
    assert np.max(directions, axis=0)[2] < -0.6
    assert np.std(np.array(directions)[:, :2]) > 0.2

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import cv2
import mujoco
import numpy as np
import pytest

from carecontact.cache_folder import CACHE_VARIABLE
from carecontact.world.human.appearance import CLOTHES, HAIR, SKIN_TONES, draw_appearance, fine_paint
from carecontact.world.human.library import load_body
from carecontact.world.human.skin import TEXTURE_SIZE, Appearance, baked_texture, painters
from carecontact.world.light import Light, draw_light, shine


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
    inside = cv2.erode(chest.astype(np.uint8), np.ones((9, 9))) > 0
    steps = np.abs(np.diff(baked_texture("man-adult").astype(int), axis=1)).max(-1)
    assert steps[inside[:, 1:]].max() <= 2


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
    shine(lit, Light(strength=1.2, warmth=1.0))
    np.testing.assert_allclose(lit.light_diffuse[1], 0.5 * 1.2 * np.array([1.10, 1.0, 0.84]), rtol=1e-6)
    np.testing.assert_allclose(lit.vis.headlight.ambient, 0.3 * 1.2 * np.array([1.10, 1.0, 0.84]), rtol=1e-6)


def test_direction_of_the_main_lamp(lit: mujoco.MjModel) -> None:
    before = lit.light_dir.copy()
    shine(lit, Light(turn_deg=180.0))
    np.testing.assert_allclose(lit.light_dir[0], before[0] * [-1, -1, 1], atol=1e-6)
    shine(lit, Light(turn_deg=180.0, tilt_deg=10.0))
    np.testing.assert_allclose(np.degrees(np.arccos(lit.light_dir[0] @ before[0])), 10.0, atol=1e-4)
    np.testing.assert_array_equal(lit.light_dir[1], before[1])


def test_the_default_light_changes_nothing(lit: mujoco.MjModel) -> None:
    before = lit.light_diffuse.copy(), lit.light_dir.copy()
    shine(lit, Light())
    np.testing.assert_array_equal(lit.light_diffuse, before[0])
    np.testing.assert_allclose(lit.light_dir, before[1], atol=1e-7)


def test_lamps_never_shine_from_below(lit: mujoco.MjModel) -> None:
    rng = np.random.default_rng(1)
    directions = []
    for _ in range(100):
        lit.light_dir[0] = [-0.19, -0.33, -0.93]
        shine(lit, draw_light(rng))
        directions.append(lit.light_dir[0].copy())
    assert np.max(directions, axis=0)[2] < -0.6
    assert np.std(np.array(directions)[:, :2]) > 0.2

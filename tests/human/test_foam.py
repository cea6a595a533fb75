"""Foam on bodies: where it lies, how large it is, what its colours differ from, and what wiping does to the texture."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from carecontact.human.foam import FoamPatch, Spot, lay_dressing, lay_foam
from carecontact.human.library import body_names, load_body
from carecontact.human.skin import CLOTHES, HAIR, SKIN_TONES, Appearance, baked_texture, coloured, painters
from carecontact.protocol.sections import FOAM_COLOURS, OTHER_COLOURS
from carecontact.world.robot import VISUAL_GROUP
from carecontact.world.scene import Scene, build_scene
from tests.protocol.foamy import FOAMY

APART = 40.0
"""Least distance in CIELAB (delta E of 1976) between foam and everything else."""


def lab(rgb: np.ndarray) -> np.ndarray:
    """(..., 3) sRGB from 0 to 255 -> CIELAB under D65 (IEC 61966-2-1, CIE 15)."""
    share = np.asarray(rgb, np.float64) / 255
    linear = np.where(share > 0.04045, ((share + 0.055) / 1.055) ** 2.4, share / 12.92)
    to_xyz = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
    xyz = linear @ to_xyz.T / [0.9505, 1.0, 1.0890]
    root = np.where(xyz > (6 / 29) ** 3, np.cbrt(xyz), xyz * (29 / 6) ** 2 / 3 + 4 / 29)
    x, y, z = np.moveaxis(root, -1, 0)
    return np.stack([116 * y - 16, 500 * (x - y), 200 * (y - z)], -1)


def scene_of(body: str, region: str) -> Scene:
    person = FOAMY.person.model_copy(update={"body": body})
    return build_scene(FOAMY.model_copy(update={"person": person}), target=region)


def texture(scene: Scene) -> np.ndarray:
    made = scene.model.texture("human_skin")
    size = int(made.width[0])
    return scene.model.tex_data[made.adr[0] : made.adr[0] + 3 * size**2].reshape(-1, 3)


def laid(scene: Scene, region: str, spot: Spot) -> FoamPatch:
    return lay_foam(scene.model, scene.body, scene.regions[region], scene.frames[region], spot)


def spot(
    half_m: tuple[float, float],
    *,
    along: float = 0.5,
    around_deg: float = 0.0,
    on_cells: bool = False,
    room_m: float = 0.0,
) -> Spot:
    return Spot(
        along=along,
        around_rad=np.radians(around_deg),
        half_m=half_m,
        room_m=room_m,
        colour=FOAM_COLOURS["lime"],
        on_cells=on_cells,
    )


def shown_colours() -> dict[str, np.ndarray]:
    """Name -> (n, 3) colours of everything that a picture shows: the room, both tools, and every person."""
    found: dict[str, np.ndarray] = {}
    for tool in ("caps", "mitt"):
        scene = FOAMY.scene.model_copy(update={"tool": tool})
        model = build_scene(FOAMY.model_copy(update={"scene": scene}), target=None).model
        for geom in range(model.ngeom):
            if model.geom_group[geom] <= VISUAL_GROUP:
                found[f"{tool} {model.geom(geom).name}"] = 255 * model.geom_rgba[geom, None, :3]
    found |= {f"baked {name}": baked_texture(name).reshape(-1, 3)[::7] for name in body_names()}
    bodies = [(body, painters(body)) for body in map(load_body, ("man-adult", "woman-old-light"))]
    most = max(map(len, (SKIN_TONES, CLOTHES, HAIR)))
    tables = (list(table.values()) for table in (SKIN_TONES, CLOTHES, HAIR))
    skin, cloth, hair = ((most * table)[:most] for table in tables)
    for number, (a, b, c) in enumerate(zip(skin, cloth, hair, strict=True)):
        body, faces = bodies[number % 2]
        found[f"painted {number}"] = coloured(faces, body, Appearance(skin=a, cloth=b, hair=c)).reshape(-1, 3)[::7]
    found |= {f"distractor {name}": np.array([colour]) for name, colour in OTHER_COLOURS.items()}
    return found


def distinct(colours: np.ndarray) -> np.ndarray:
    """(n, 3) -> its rows, rounded, each once; sorting whole numbers is thirty times faster than sorting rows."""
    steps = [1 << 16, 1 << 8, 1]
    return np.unique(colours.round().astype(int) @ steps)[:, None] // steps % 256


def test_foam_has_a_colour_of_its_own() -> None:
    shown = {name: lab(distinct(colours)) for name, colours in shown_colours().items()}
    assert len(shown) > 60
    for name, colour in FOAM_COLOURS.items():
        nearest = {other: np.linalg.norm(lab(np.array(colour)) - rows, axis=1).min() for other, rows in shown.items()}
        closest = min(nearest, key=lambda other: nearest[other])
        assert nearest[closest] >= APART, f"{name} is only {nearest[closest]:.0f} from {closest}"


@pytest.mark.parametrize(
    ("body", "region"), [("woman-old-light", "forearm"), ("man-adult-heavy", "upper_arm"), ("man-old-heavy", "abdomen")]
)
def test_a_patch_has_its_size_and_lies_where_it_was_drawn(body: str, region: str) -> None:
    scene = scene_of(body, region)
    before, length = texture(scene).copy(), float(scene.frames[region].size_m[0])
    for half_m, around_deg, on_cells in (((0.025, 0.025), 30.0, False), ((0.05, 0.02), -45.0, True)):
        patch = laid(scene, region, spot(half_m, along=0.4, around_deg=around_deg, on_cells=on_cells))
        if not on_cells:
            assert patch.middle[0] == pytest.approx(-0.1 * length)
            assert np.degrees(np.arctan2(patch.middle[1], patch.middle[2])) == pytest.approx(around_deg)
        else:
            # The flat ellipse, and up to a tenth more on a round limb; the edge is counted by whole triangles.
            area = patch.cell_share @ scene.regions[region].cells.areas
            assert area == pytest.approx(np.pi * np.prod(half_m), rel=0.15)
        at = scene.frames[region].origin + scene.frames[region].axes @ patch.middle
        assert np.linalg.norm(scene.body.vertices - at, axis=1).min() < 0.015
        assert np.linalg.det(patch.axes) == pytest.approx(1.0)
        changed = np.flatnonzero((texture(scene) != before).any(1))
        assert set(changed) <= set(patch.texel.tolist())
        assert len(changed) > 200
        texture(scene)[:] = before


def test_a_dressing_lies_on_the_side_of_its_limb_that_faces_up() -> None:
    scene = scene_of("man-adult", "forearm")
    before, half_m = texture(scene).copy(), (0.04, 0.025)
    lay_dressing(scene.model, scene.body, "left_forearm", along=0.5, half_m=half_m, colour=OTHER_COLOURS["blue"])
    changed = np.flatnonzero((texture(scene) != before).any(1))
    assert (texture(scene)[changed] == OTHER_COLOURS["blue"]).all(1).mean() > 0.7
    patch = laid(scene, "forearm", spot(half_m))
    assert len(changed) == pytest.approx(len(patch.texel), rel=0.3), "both arms have the same texture, mirrored"
    assert not set(changed) & set(patch.texel.tolist())


def test_a_touchs_foam_lies_on_soft_skin() -> None:
    """The shell of an abdomen ends before its flank, which is rigid."""
    scene = scene_of("man-old-heavy", "abdomen")
    patch = laid(scene, "abdomen", spot((0.025, 0.025), around_deg=45.0))
    shell, frame = scene.regions["abdomen"].shell, scene.frames["abdomen"]
    across = ((shell.vertices - frame.origin) @ frame.axes)[:, 1]
    assert 0.06 < patch.middle[1] < across.max() - 0.015
    assert np.degrees(np.arctan2(patch.middle[1], patch.middle[2])) < 45.0


def test_foam_leaves_room_beside_it_for_the_tool() -> None:
    scene = scene_of("man-adult", "forearm")
    length = float(scene.frames["forearm"].size_m[0])
    near = laid(scene, "forearm", spot((0.025, 0.025), along=0.85, room_m=0.015))
    assert length / 2 - 0.04 - 0.05 * 0.35 * length <= near.middle[0] <= length / 2 - 0.04
    short = laid(scene, "forearm", spot((0.025, 0.025), along=0.85, room_m=0.14))
    assert short.middle[0] == pytest.approx(0.0, abs=1e-9), (
        "a region that is too short for it has its foam in the middle"
    )


def test_a_scrubs_foam_lies_where_wiping_is_measured() -> None:
    """At the end of a forearm and on its flank there are no cells: the oval is moved as far as it must, a disc is
    not."""
    scene = scene_of("man-adult-light", "forearm")
    moved = laid(scene, "forearm", spot((0.05, 0.02), along=0.85, around_deg=45.0, on_cells=True))
    left = laid(scene, "forearm", spot((0.05, 0.02), along=0.85, around_deg=45.0))
    areas = scene.regions["forearm"].cells.areas
    full = np.pi * 0.05 * 0.02
    assert moved.cell_share @ areas > 0.95 * full > 1.3 * (left.cell_share @ areas)
    assert 0 < moved.middle[0] < left.middle[0]
    disc = laid(scene, "forearm", spot((0.025, 0.025), along=0.85, around_deg=45.0))
    assert disc.middle[0] == pytest.approx(0.35 * scene.frames["forearm"].size_m[0])


def test_wiping_a_cell_bares_its_skin_and_no_other() -> None:
    scene = scene_of("woman-adult-light", "abdomen")
    bare = texture(scene).copy()
    patch = laid(scene, "abdomen", spot((0.05, 0.02), on_cells=True))
    foamed = texture(scene).copy()
    assert (foamed[patch.texel[patch.strength == 1]] == FOAM_COLOURS["lime"]).all()
    left = np.ones(len(patch.cell_share))
    wiped = int(np.bincount(patch.cell).argmax())
    left[wiped] = 0.0
    patch.paint(scene.model, left)
    mine = patch.texel[patch.cell == wiped]
    others = np.setdiff1d(np.arange(len(bare)), mine)
    np.testing.assert_array_equal(texture(scene)[mine], bare[mine])
    np.testing.assert_array_equal(texture(scene)[others], foamed[others])
    patch.paint(scene.model, 0 * left)
    np.testing.assert_array_equal(texture(scene), bare)
    patch.paint(scene.model)
    np.testing.assert_array_equal(texture(scene), foamed)
    # Each third of the way is a step that can be seen.
    steps = [lab(patch.colours(np.full(len(left), k / 3))[patch.strength == 1].mean(0)) for k in range(4)]
    assert min(np.linalg.norm(a - b) for a, b in pairwise(steps)) > 15

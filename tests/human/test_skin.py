from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable
from importlib import resources
from pathlib import Path

import mujoco
import numpy as np
import pytest

from carecontact.errors import AssetError
from carecontact.human import library
from carecontact.human.body import Body
from carecontact.human.library import load_body
from carecontact.human.skeleton import body_name
from carecontact.human.skin import TEXTURE_SIZE, Appearance, baked_texture, paint
from carecontact.pictures import png
from carecontact.world.scene import Scene
from tests.human.conftest import SOME_QUICK

BODIES = resources.files("carecontact") / "assets" / "bodies"


@pytest.fixture
def skins(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Path of man-adult's texture, free to be damaged."""
    folder = tmp_path / "assets" / "bodies"
    folder.mkdir(parents=True)
    path = folder / "man-adult.skin.png"
    with resources.as_file(BODIES / path.name) as source:
        shutil.copy(source, path)
    monkeypatch.setattr(library.resources, "files", lambda _: tmp_path)
    return path


def test_texture_is_the_one_painted_for_this_body(body: Body) -> None:
    record = json.loads((BODIES / f"{body.name}.skin.provenance.json").read_text())
    assert hashlib.sha256((BODIES / f"{body.name}.skin.png").read_bytes()).hexdigest() == record["sha256"]
    assert record["body_sha256"] == body.sha256, "the body was baked again: run tools/bake_skin.py"


def test_texture_loads_in_rgb(body: Body) -> None:
    image = baked_texture(body.name)
    assert image.shape == (TEXTURE_SIZE, TEXTURE_SIZE, 3)
    colours = image.reshape(-1, 3)
    painted = json.loads((BODIES / f"{body.name}.skin.provenance.json").read_text())["appearance"]
    on_skin = np.abs(colours - np.array(painted["skin"], float)).max(1) < 25
    assert on_skin.mean() > 0.5
    # Skin is more red than blue: swapped channels would turn the person blue.
    assert (colours[on_skin, 0] > colours[on_skin, 2]).all()
    on_cloth = np.abs(colours - np.array(painted["cloth"], float)).max(1) < 15
    assert 0.01 < on_cloth.mean() < 0.2


SMALL = png(np.zeros((64, 64, 3), np.uint8))


@pytest.mark.parametrize(
    ("damage", "fault"),
    [
        (None, r".*run tools/bake_skin\.py"),
        (b"", ""),
        (b"no picture", ""),
        (b"\x89PNG\r\n\x1a\n", ""),
        (SMALL, ".* is not a 1024 x 1024 colour PNG"),
    ],
)
def test_a_missing_or_broken_texture_is_named(skins: Path, damage: bytes | None, fault: str) -> None:
    skins.unlink()
    if damage is not None:
        skins.write_bytes(damage)
    with pytest.raises(AssetError, match=f"skin of body man-adult: {fault}"):
        baked_texture("man-adult")


@pytest.mark.parametrize("name", SOME_QUICK)
def test_cloth_colour_changes_the_clothes_and_nothing_else(name: str) -> None:
    body = load_body(name)
    plain, red = paint(body, Appearance()), paint(body, Appearance(cloth=(200, 20, 20)))
    changed = (plain != red).any(-1)
    assert 0.01 < changed.mean() < 0.2
    middle = body.uv[body.uv_faces].mean(1) * TEXTURE_SIZE
    row, column = (TEXTURE_SIZE - middle[:, 1]).astype(int), middle[:, 0].astype(int)
    faces = changed[row, column]
    owner = body.owner[body.faces[:, 0]]
    # A face of bare skin beside the cloth may share a pixel with it.
    segments = {name for k, name in enumerate(body.segments) if faces[owner == k].mean() > 0.05}
    top = {"left_clavicle", "right_clavicle"} if body.sex == "F" else set()
    assert segments <= {"pelvis", "abdomen", "thorax", "left_thigh", "right_thigh"} | top
    pelvis = faces[owner == body.segments.index("pelvis")]
    assert pelvis.mean() > 0.5


def test_every_skin_vertex_is_carried_in_full(scene_of: Callable[[str | None], Scene]) -> None:
    model = scene_of("forearm").model
    total = np.zeros(model.nskinvert)
    np.add.at(total, model.skin_bonevertid, model.skin_bonevertweight)
    np.testing.assert_allclose(total, 1.0, atol=2e-3)
    assert model.skin_facenum.sum() > 20_000


def test_drawn_skin_follows_the_bones(scene_of: Callable[[str | None], Scene]) -> None:
    """In an odd pose a fingertip of the drawn skin is where the hand's own frame puts it."""
    scene = scene_of("forearm")
    model, data = scene.model, mujoco.MjData(scene.model)
    for name, angle in (("right_upper_arm_abduction", 70), ("right_forearm_flexion", 60), ("right_hand_flexion", 30)):
        data.qpos[model.joint(f"human_{name}").qposadr[0]] = np.radians(angle)
    mujoco.mj_forward(model, data)
    made = mujoco.MjvScene(model, maxgeom=4 * model.ngeom)
    mujoco.mjv_updateScene(
        model, data, mujoco.MjvOption(), None, mujoco.MjvCamera(), mujoco.mjtCatBit.mjCAT_ALL.value, made
    )
    drawn, bind = np.asarray(made.skinvert).reshape(-1, 3), np.asarray(model.skin_vert).reshape(-1, 3)
    body, hand = scene.body, data.body(body_name("right_hand"))
    offsets = bind - body.joint_centre["right_hand"]
    near = np.flatnonzero(np.linalg.norm(offsets, axis=1) < 0.25)
    tip = near[(offsets[near] @ body.direction("right_hand")).argmax()]
    assert offsets[tip] @ body.direction("right_hand") > 0.15
    np.testing.assert_allclose(drawn[tip], hand.xpos + hand.xmat.reshape(3, 3) @ offsets[tip], atol=1e-5)

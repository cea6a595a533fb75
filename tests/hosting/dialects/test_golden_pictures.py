"""Exactly the pixels that every profile sends, as the server finds them, against stored pictures.

Each camera shows four corners of different colours on a ground of its own; a picture of 4:3 has white bars, which lie
outside 16:9. `python -m tests.hosting.dialects.test_golden_pictures` writes the stored pictures anew: look at them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from carecontact.contract.observation import CameraView
from tests.hosting.dialects.fakes import Fake, Openpi, OpenpiPositions, RoboArena, VlaEval
from tests.hosting.dialects.talking import INSTRUCTION, policy_at, seen
from tests.policies.synthetic import SESSION

FOLDER = Path(__file__).parents[2] / "data" / "dialects"
GROUNDS = {"exterior": (200, 160, 40), "wrist": (40, 120, 200), "bedside": (150, 60, 170)}
CORNERS = {
    (0, 0): (250, 20, 10), (0, -1): (15, 230, 30), (-1, 0): (20, 10, 240), (-1, -1): (245, 235, 20),
}  # fmt: skip
"""Top left red, top right green, bottom left blue, bottom right yellow."""
BAR = (255, 255, 255)
EXTERIOR, WRIST = "observation/exterior_image_{}_left", "observation/wrist_image_left"


def camera(name: str, *, height: int, width: int = 640) -> CameraView:
    """A corner covers a quarter of each side of the part of 16:9."""
    rgb = np.full((height, width, 3), BAR, np.uint8)
    high = width * 9 // 16
    part = rgb[(height - high) // 2 :][:high]
    part[:] = GROUNDS[name]
    for (y, x), colour in CORNERS.items():
        rows, columns = (
            (slice(0, high // 4), slice(-(high // 4), None)),
            (slice(0, width // 4), slice(-(width // 4), None)),
        )
        part[rows[y], columns[x]] = colour
    return CameraView(intrinsics=np.eye(3), pose_camera_in_base=np.eye(4), rgb=rgb)


@dataclass(frozen=True)
class Case:
    make: Callable[[], Fake]
    address: str
    keys: dict[str, str]
    """Key of a picture -> camera."""
    shape: tuple[int, int]
    pad: int = 0
    """Black rows above and below."""


DROID = {EXTERIOR.format(1): "exterior", WRIST: "wrist"}
ARENA = {EXTERIOR.format(0): "exterior", EXTERIOR.format(1): "bedside", WRIST: "wrist"}
CASES = {
    "pi05-droid": Case(Openpi, "openpi://127.0.0.1:{}?profile=pi05-droid", DROID, (224, 224), 49),
    "pi05-droid-jointpos": Case(
        OpenpiPositions, "openpi://127.0.0.1:{}?profile=pi05-droid-jointpos", DROID, (224, 224), 49
    ),
    "roboarena": Case(lambda: RoboArena(external=2, first=0), "roboarena://127.0.0.1:{}?exterior=0", ARENA, (224, 224)),
    "roboarena-as-captured": Case(
        lambda: RoboArena(external=2, first=0, resolution=None),
        "roboarena://127.0.0.1:{}?exterior=0",
        ARENA,
        (288, 512),
    ),
    "vla-eval": Case(
        VlaEval, "vla-eval://127.0.0.1:{}", {"exo_camera_1": "exterior", "wrist_camera": "wrist"}, (360, 640)
    ),
}


def sent(case: Case) -> dict[str, np.ndarray]:
    """Key -> picture, as a server decodes its first observation."""
    server = case.make()
    views = {"exterior": camera("exterior", height=360)}
    views |= {"wrist": camera("wrist", height=480), "bedside": camera("bedside", height=482)}
    with server.running() as port, policy_at(case.address.format(port)) as policy:
        policy.start()
        policy.reset(INSTRUCTION, SESSION)
        policy.act(replace(seen(), cameras=views))
    heard: list[dict[str, Any]] = [message.get("payload", message) for message in server.heard]
    shown = next(message for message in heard if "prompt" in message or "images" in message)
    images = {key: value for key, value in shown.items() if "image_" in key}
    return images or shown["images"]


def beside(images: dict[str, np.ndarray]) -> np.ndarray:
    return np.concatenate(list(images.values()), axis=1)


@pytest.mark.parametrize("name", CASES)
def test_what_is_sent_is_the_stored_picture(name: str) -> None:
    with Image.open(FOLDER / f"{name}.png") as golden:
        assert (beside(sent(CASES[name])) == np.asarray(golden)).all()


@pytest.mark.parametrize("name", CASES)
def test_colours_corners_cameras_and_padding(name: str) -> None:
    case = CASES[name]
    images = sent(case)
    assert list(images) == list(case.keys)
    for key, image in images.items():
        height, width = case.shape
        assert image.shape == (height, width, 3)
        assert not image[: case.pad].any()
        assert not image[height - case.pad :].any()
        shown = image[case.pad : height - case.pad].astype(int)
        high = len(shown)
        for (y, x), colour in CORNERS.items():
            inside = shown[(high // 8, -(high // 8))[y], (width // 8, -(width // 8))[x]]
            assert abs(inside - colour).max() <= 2, (key, y, x)
        assert abs(shown[high // 2, width // 2] - GROUNDS[case.keys[key]]).max() <= 2, key
        # No bar of a picture of 4:3 is left: the outermost row has the colours of the corners and the ground.
        assert (shown[0].min(-1) < 200).all(), key


if __name__ == "__main__":
    for name, case in CASES.items():
        Image.fromarray(beside(sent(case))).save(FOLDER / f"{name}.png")

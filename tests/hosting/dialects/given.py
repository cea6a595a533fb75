"""What the fixtures of tests/data/openpi are made of; openpi's own client reads this file, too, so it needs numpy 1."""

from __future__ import annotations

from typing import Any

import numpy as np

SIZES = [
    ((360, 640), (224, 224)),
    ((480, 640), (224, 224)),
    ((1280, 720), (224, 224)),
    ((37, 100), (48, 64)),
    ((100, 37), (48, 64)),
    ((5, 7), (48, 64)),
    ((224, 224), (224, 224)),
]
"""(height, width) of a picture -> (height, width) that it is brought to."""


def picture(height: int, width: int) -> Any:
    """(H, W, 3) of bytes: waves, edges and a corner of another colour, different in every channel and direction."""
    y, x = np.mgrid[0:height, 0:width]
    rgb = np.stack([(x * 3 + y) % 256, (y * 5) % 256, (x // 16 % 2) * 200 + (y // 9 % 2) * 55], -1).astype(np.uint8)
    rgb[: height // 4, : width // 4] = (250, 20, 5)
    return rgb


def actions(steps: int) -> Any:
    """(steps, 8) of float32, all different; the last column is a gripper command."""
    chunk = np.sin(np.arange(steps * 8, dtype=np.float64)).reshape(steps, 8).astype(np.float32)
    chunk[:, 7] = np.linspace(0, 1, steps, dtype=np.float32)
    return chunk


def request() -> dict[str, Any]:
    return {
        "observation/exterior_image_1_left": picture(4, 6),
        "observation/wrist_image_left": picture(4, 6)[::-1].copy(),
        "observation/joint_position": np.linspace(-1, 1, 7),
        "observation/gripper_position": np.ones(1),
        "prompt": "gently touch the right forearm",
    }


def metadata() -> dict[str, Any]:
    return {"reset_pose": [0, -1.5, 1.5, 0, 0, 0], "scale": np.float32(0.5), "flag": np.bool_(True)}

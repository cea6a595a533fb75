"""Write the messages of docs/evidence/wire-bytes.md, byte by byte, from the code that sends and reads them.

python tools/wire_page.py [--check]
"""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any

import numpy as np

from carecontact.interface.action import Action
from carecontact.interface.observation import CameraView, Observation
from carecontact.interface.policy import PolicyCard
from carecontact.interface.robot import ActionBounds, Compliance, Session
from carecontact.serving import codec
from carecontact.serving.codec import CLOSE, act_message, reset_message
from carecontact.serving.packing import is_array, is_list, is_map, pack, unpack

PAGE = Path(__file__).parents[1] / "docs" / "evidence" / "wire-bytes.md"
BLOCK = re.compile(r"<!-- message: (\w+) -->\n.*?<!-- end -->", re.DOTALL)
WIDTH, GROUP = 16, 8
"""Bytes in a line, and in a group of it."""
SESSION = Session(
    action_bounds=ActionBounds(
        workspace_low_m=(0.0, -0.6, 0.0),
        workspace_high_m=(1.0, 0.6, 0.75),
        translational_stiffness=(100.0, 1000.0),
        rotational_stiffness=(5.0, 50.0),
    ),
    joint_low_rad=(-2.8973, -1.7628, -2.8973, -3.0718, -2.8973, -0.0175, -2.8973),
    joint_high_rad=(2.8973, 1.7628, 2.8973, -0.0698, 2.8973, 3.7525, 2.8973),
    camera_sizes_px={"overhead": (640, 480), "bedside": (640, 480), "exterior": (640, 360), "wrist": (640, 480)},
    time_limit_s=30.0,
    compliance=Compliance(
        stiffness=(400.0, 30.0), damping_ratio=1.0, effective_mass_kg=10.0, effective_inertia_kgm2=0.25
    ),
)
OBSERVATION = Observation(
    instruction="gently touch the right forearm",
    sim_time_s=0.5,
    joint_position=np.array([0.5, -0.25, 0.25, -1.75, 0.125, 1.5, 1.0]),
    joint_velocity=np.zeros(7),
    gripper_position=np.zeros(1),
    pose_tcp_in_base=np.array([0.25, 0.375, 0.5, 0.0, 1.0, 0.0, 0.0]),
    cameras={
        "overhead": CameraView(
            intrinsics=np.array([[2.0, 0.0, 0.5], [0.0, 2.0, 0.0], [0.0, 0.0, 1.0]]),
            pose_camera_in_base=np.diag([1.0, -1.0, -1.0, 1.0]),
            rgb=np.arange(6, dtype=np.uint8).reshape(1, 2, 3),
        )
    },
)
ACTIONS = [Action(pose_tcp_in_base=np.array([0.25, 0.375, 0.4375, 0.0, 1.0, 0.0, 0.0])), Action(done=True)]


def messages() -> dict[str, bytes]:
    """Return one message of every kind; the images are 2 by 1 pixels, so that their bytes fit on the page."""
    card = PolicyCard(name="my-policy", modalities=("rgb",), control_hz=10)
    listed = {"type": "actions", "actions": [{"pose_tcp_in_base": [0.25, 0.375, 0.4375, 0.0, 1.0, 0.0, 0.0]}]}
    return {
        "card": pack({"type": "card", "card": codec.encode_card(card)}),
        "reset": reset_message(OBSERVATION.instruction, SESSION),
        "ready": pack({"type": "ready"}),
        "act": act_message(OBSERVATION),
        "actions": pack({"type": "actions", "actions": codec.encode_actions(ACTIONS)}),
        "actions_list": pack(listed),
        "error": pack({"type": "error", "kind": "exception", "message": "ValueError: no plan"}),
        "close": CLOSE,
    }


def shown(value: Any, *, indent: int = 0) -> str:
    """Return a message's content in the notation of JSON (None is nil), with arrays as ``array(<dtype>, <shape>)``."""
    inner, outer = " " * (indent + 2), " " * indent
    if is_array(value):
        return f'array("{value.dtype.str}", {list(value.shape)})'
    if is_map(value) and value:
        rows = [f'{inner}"{key}": {shown(entry, indent=indent + 2)}' for key, entry in value.items()]
        return "{\n" + ",\n".join(rows) + f"\n{outer}}}"
    if is_list(value) and any(is_map(entry) for entry in value):
        return "[" + ", ".join(shown(entry, indent=indent) for entry in value) + "]"
    return repr(value).replace("'", '"')


def dumped(data: bytes) -> str:
    """Return a hex dump: offset, bytes, and the characters that can be printed."""
    rows: list[str] = []
    for start in range(0, len(data), WIDTH):
        piece = data[start : start + WIDTH]
        text = "".join(chr(byte) if 32 <= byte < 127 else "." for byte in piece)
        rows.append(f"{start:04x}  {piece.hex(' ', -GROUP):{2 * WIDTH + WIDTH // GROUP - 1}}  {text}")
    return "\n".join(rows)


def filled(page: str) -> str:
    """Return the page with every block between its markers made again. Raises KeyError for an unknown message."""
    found = messages()

    def block(match: re.Match[str]) -> str:
        data = found[match[1]]
        content = f"```js\n{shown(unpack(data))}\n```\n\n{len(data)} bytes:\n\n```text\n{dumped(data)}\n```"
        return f"<!-- message: {match[1]} -->\n{content}\n<!-- end -->"

    return BLOCK.sub(block, page)


def main() -> int:
    page = PAGE.read_text(encoding="utf-8")
    new = filled(page)
    if "--check" in sys.argv[1:]:
        return int(new != page)
    PAGE.write_text(new, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())

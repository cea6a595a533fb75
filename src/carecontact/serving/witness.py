"""The audit's own policy: it requests what another policy requests, plays a given motion, and notes all that reaches
it."""

from __future__ import annotations

import gc
import json
import os
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np
from websockets.sync.server import ServerConnection

from carecontact.errors import ContractError
from carecontact.interface.action import Action
from carecontact.interface.observation import Observation
from carecontact.interface.policy import PolicyCard
from carecontact.interface.robot import Session
from carecontact.serving import codec
from carecontact.serving.child import RECEIVED
from carecontact.serving.fence import CACHE_FOLDERS

TASK, RECEIVED_FILE = "witness.json", "received.json"
"""Files in the witness's folder: what it shall do, and what reached it."""
CHANCE_OPTIONS = ("report_fd", "lifeline_fd", "stack_fd", "harness_port")
CHANCE_VARIABLES = ("TMPDIR", *CACHE_FOLDERS)
CHANCE_HEADERS = ("host", "sec-websocket-key")
"""Headers whose values the operating system or a random generator chooses, and no trial."""


class Witness:
    """Shows the card in TASK and plays its poses, ``actions_per_look`` at a time; the last action is ``done``.

    At ``reset`` it writes to RECEIVED_FILE everything that has reached its process by then.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        task = cast(dict[str, Any], json.loads((folder / TASK).read_text()))
        self.card: PolicyCard = replace(codec.decode_card(task["card"]), control_hz=float(task["control_hz"]))
        self._poses: list[list[float]] = task["poses"]
        self._actions_per_look: int = task["actions_per_look"]
        self._session: object = None
        self._next = 0

    def configure(self, session: Session) -> None:
        self._session = codec.encode_session(session)

    def reset(self, instruction: str) -> None:
        self._next = 0
        received = {**everything_here(), "instruction": instruction, "session": self._session}
        (self._folder / RECEIVED_FILE).write_text(json.dumps(received))

    def act(self, observation: Observation) -> list[Action]:
        """Return the next part of the motion, whatever the observation shows."""
        first, self._next = self._next, self._next + self._actions_per_look
        poses = self._poses[first : self._next]
        if not poses:
            raise ContractError(f"act() after the last of {len(self._poses)} poses was done")
        ends = len(poses) if self._next >= len(self._poses) else 0
        return [Action(pose_tcp_in_base=np.array(pose), done=k == ends) for k, pose in enumerate(poses, start=1)]


def everything_here() -> dict[str, object]:
    """Return command line, options, environment, folder, open files and the connection's opening request."""
    # isinstance would fail here: it asks a weak proxy for the class of an object that is gone.
    request = next((o.request for o in gc.get_objects() if issubclass(type(o), ServerConnection)), None)
    headers = [] if request is None else sorted(request.headers.raw_items())
    return {
        "command_line": list(sys.orig_argv),
        "options": {name: value for name, value in RECEIVED.items() if name not in CHANCE_OPTIONS},
        "environment": {name: value for name, value in os.environ.items() if name not in CHANCE_VARIABLES},
        "folder": os.getcwd(),
        "open_files": sorted(str(file.readlink()) for file in Path("/proc/self/fd").glob("*") if file.is_file()),
        "request": {
            "path": None if request is None else request.path,
            "headers": [list(pair) for pair in headers if pair[0].lower() not in CHANCE_HEADERS],
        },
    }

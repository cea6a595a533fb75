"""Servers written from the descriptions of openpi, RoboArena, vllm-omni and vla-eval, with nothing of carecontact.

Each keeps what it was asked and what it answered.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from typing import Any

import msgpack
import numpy as np
from websockets.exceptions import ConnectionClosed
from websockets.sync.server import Request, Response, Server, ServerConnection, serve

from carecontact.interface.observation import CameraView, Observation
from carecontact.interface.policy import PolicyRef
from carecontact.serving.client import ActReply
from carecontact.serving.conversation import PolicySetup
from carecontact.serving.opening import RemotePolicy
from tests.policies.synthetic import SESSION, synthetic_observation

OMNI_PATH = "/v1/realtime/robot/openpi"


def mark(value: Any) -> Any:
    """What openpi's msgpack_numpy makes of arrays and of numpy's numbers."""
    if isinstance(value, np.ndarray):
        return {b"__ndarray__": True, b"data": value.tobytes(), b"dtype": value.dtype.str, b"shape": value.shape}
    if isinstance(value, np.generic):
        return {b"__npgeneric__": True, b"data": value.item(), b"dtype": value.dtype.str}
    raise TypeError(type(value))


def unmark(entries: dict[Any, Any]) -> Any:
    if b"__ndarray__" in entries:
        return np.ndarray(buffer=entries[b"data"], dtype=entries[b"dtype"], shape=entries[b"shape"])
    return entries


def text_mark(value: Any) -> Any:
    """The same of vla-eval, with text as keys."""
    return {"__ndarray__": True, "data": value.tobytes(), "dtype": value.dtype.str, "shape": list(value.shape)}


def text_unmark(entries: dict[str, Any]) -> Any:
    if "__ndarray__" not in entries:
        return entries
    return np.frombuffer(entries["data"], np.dtype(entries["dtype"])).reshape(entries["shape"]).copy()


def packed(value: Any) -> bytes:
    return msgpack.packb(value, default=mark)


def slow_chunk(number: int, steps: int, *, positions: np.ndarray | None = None) -> np.ndarray:
    """(steps, 8) of float32, different in every call, row and column, and harmless: velocities below 0.02, or targets
    within 0.002 rad of ``positions``."""
    wave = np.sin(np.arange(steps * 8) + 1 + 100 * number).reshape(steps, 8)
    chunk = (wave * 0.02 if positions is None else wave * 0.002).astype(np.float32)
    if positions is not None:
        chunk[:, :7] += positions.astype(np.float32)
    chunk[:, 7] = number % 2
    return chunk


@dataclass
class Fake:
    """One server. ``converse`` of a subclass speaks with one client."""

    steps: int = 10
    fault: Callable[[Any], Any] | None = None
    """Made of a good answer in place of it, before it is packed; bytes and text are sent as they are."""
    heard: list[Any] = field(default_factory=list)
    answered: list[np.ndarray] = field(default_factory=list)
    paths: list[str] = field(default_factory=list)
    headers: list[str | None] = field(default_factory=list)

    def converse(self, connection: ServerConnection) -> None:
        raise NotImplementedError

    def chunk(self, observation: dict[str, Any]) -> np.ndarray:
        self.answered.append(slow_chunk(len(self.answered), self.steps))
        return self.answered[-1]

    def pack(self, answer: Any) -> bytes | str:
        spoilt = answer if self.fault is None else self.fault(answer)
        return spoilt if isinstance(spoilt, bytes | str) else packed(spoilt)

    @contextmanager
    def running(self) -> Iterator[int]:
        """The port."""

        def note(connection: ServerConnection, request: Request) -> Response | None:
            self.paths.append(request.path)
            self.headers.append(request.headers.get("Authorization"))
            return None

        handlers: list[threading.Thread] = []

        def converse(connection: ServerConnection) -> None:
            handlers.append(threading.current_thread())
            with suppress(ConnectionClosed):
                self.converse(connection)

        server: Server = serve(converse, "127.0.0.1", 0, max_size=None, compression=None, process_request=note)
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        try:
            yield server.socket.getsockname()[1]
        finally:
            server.shutdown()
            for one in (thread, *handlers):
                one.join(20)


@dataclass
class Openpi(Fake):
    """serving/websocket_policy_server.py: metadata, which DROID leaves empty, then a reply for each observation."""

    metadata: dict[str, Any] = field(default_factory=dict)
    bare: bool = False

    def converse(self, connection: ServerConnection) -> None:
        connection.send(packed(self.metadata))
        for frame in connection:
            observation = msgpack.unpackb(frame, object_hook=unmark)
            self.heard.append(observation)
            actions = self.chunk(observation)
            reply = {"actions": actions, "state": np.zeros(8), "policy_timing": {"infer_ms": np.float64(1)}}
            reply["server_timing"] = {"infer_ms": 1.0}
            connection.send(self.pack(actions if self.bare else reply))


@dataclass
class OpenpiPositions(Openpi):
    """A joint-position checkpoint: its targets are the state that it saw plus small differences."""

    def chunk(self, observation: dict[str, Any]) -> np.ndarray:
        positions = observation["observation/joint_position"]
        self.answered.append(slow_chunk(len(self.answered), self.steps, positions=positions))
        return self.answered[-1]


@dataclass
class RoboArena(Fake):
    """roboarena/policy_server.py: config first, then endpoints; refuses keys that it did not ask for."""

    first: int = 1
    external: int = 1
    session: bool = True
    resolution: tuple[int, int] | None = (224, 224)
    space: str = "joint_velocity"

    @property
    def metadata(self) -> dict[str, Any]:
        return {
            "image_resolution": self.resolution,
            "needs_wrist_camera": True,
            "n_external_cameras": self.external,
            "needs_stereo_camera": False,
            "needs_session_id": self.session,
            "action_space": self.space,
        }

    def confirmed(self) -> bytes | str:
        return "reset successful"

    def answer(self, actions: np.ndarray) -> Any:
        return {"actions": actions}

    def converse(self, connection: ServerConnection) -> None:
        connection.send(packed(self.metadata))
        wanted = {f"observation/exterior_image_{self.first + i}_left" for i in range(self.external)}
        wanted |= {"observation/wrist_image_left", "observation/joint_position", "observation/cartesian_position"}
        wanted |= {"observation/gripper_position", "prompt"} | ({"session_id"} if self.session else set())
        for frame in connection:
            message = msgpack.unpackb(frame, object_hook=unmark)
            self.heard.append(dict(message))
            if message.pop("endpoint") == "reset":
                connection.send(self.confirmed())
            elif set(message) != wanted:
                connection.send(f"Traceback (most recent call last):\nKeyError: {sorted(set(message) ^ wanted)}")
                connection.close(1011)
            else:
                connection.send(self.pack(self.answer(self.chunk(message))))


@dataclass
class Omni(RoboArena):
    """entrypoints/openpi/connection.py of vllm-omni: another path, confirmations and errors as maps, bare arrays."""

    def confirmed(self) -> bytes | str:
        return packed({"status": "reset successful"})

    def answer(self, actions: np.ndarray) -> Any:
        return actions


@dataclass
class VlaEval(Fake):
    """model_servers/serve.py of vla-eval: an envelope, HELLO, one action for each observation."""

    payload: dict[str, Any] = field(
        default_factory=lambda: {
            "observation_params": {"send_wrist_image": True, "send_state": True},
            "action_spec": {"joints": {"name": "joints", "dims": 7, "format": "joint_pos_abs", "range": [-3.15, 3.15]}},
        }
    )
    version: int = 1

    def converse(self, connection: ServerConnection) -> None:
        for frame in connection:
            message = msgpack.unpackb(frame, object_hook=text_unmark)
            self.heard.append(message)
            if message["type"] == "hello":
                hello = {"harness_version": "0.8.0", "protocol_version": self.version, "capabilities": {}}
                self.tell(connection, "hello", {**hello, "model_server": "Fake", **self.payload}, message["seq"])
            elif message["type"] == "observation":
                states = message["payload"]["states"]
                row = slow_chunk(len(self.answered), 1, positions=states[:7])[0]
                self.answered.append(row[None])
                answer = {"actions": row}
                spoilt = answer if self.fault is None else self.fault(answer)
                if isinstance(spoilt, bytes | str):
                    connection.send(spoilt)
                else:
                    kind = "error" if "error" in spoilt else "action"
                    self.tell(connection, kind, spoilt, message["seq"])

    def tell(self, connection: ServerConnection, kind: str, payload: dict[str, Any], seq: int) -> None:
        message = {"type": kind, "payload": payload, "seq": seq, "timestamp": 1.5e9}
        connection.send(msgpack.packb(message, default=text_mark))


# What the fixtures of tests/data/openpi are made of; openpi's own client reads this file, too, so it needs numpy 1.

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


# A conversation with a fake server, as a trial has it, but with observations that nothing was rendered for.

INSTRUCTION = "gently touch the right forearm"
JOINTS = np.array([0.5, -0.4, 0.4, -1.8, 0.1, 1.5, 1.1])


def view(height: int, width: int) -> CameraView:
    return CameraView(intrinsics=np.eye(3), pose_camera_in_base=np.eye(4), rgb=picture(height, width))


def seen() -> Observation:
    """What the cameras of bathing-v3 would show, in size: every picture other than the others."""
    cameras = {"exterior": view(360, 640), "wrist": view(480, 640), "bedside": view(482, 640)}
    return replace(synthetic_observation(cameras=cameras), instruction=INSTRUCTION, joint_position=JOINTS)


def policy_at(address: str, *, key: str = "", deadline_s: float = 20.0) -> RemotePolicy:
    ref = replace(PolicyRef.parse(address), credentials=key)
    return RemotePolicy(PolicySetup(ref=ref), first_deadline_s=deadline_s, deadline_s=deadline_s)


def talk(address: str, *, calls: int = 3, key: str = "", deadline_s: float = 20.0) -> list[ActReply]:
    """What a server answers to the same observation again and again."""
    with policy_at(address, key=key, deadline_s=deadline_s) as policy:
        policy.start()
        policy.reset(INSTRUCTION, SESSION)
        return [policy.act(seen()) for _ in range(calls)]


def joints(replies: list[ActReply]) -> np.ndarray:
    """(n, 7) of all actions that would be executed."""
    given = [action.joint for reply in replies for action in reply.actions]
    return np.array([joint for joint in given if joint is not None])

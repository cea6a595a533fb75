"""Serve a policy to the benchmark carecontact: `serve(MyPolicy)`. Needs websockets, msgpack and numpy, nothing else."""

from __future__ import annotations

import threading
import traceback
from typing import Any, Callable

import msgpack
import numpy as np
from websockets.exceptions import ConnectionClosed
from websockets.sync.server import ServerConnection
from websockets.sync.server import serve as _listen

__all__ = ["decode", "encode", "serve"]

MAX_MESSAGE_BYTES = 256 << 20
TRACEBACK_CHARS = 2000


def serve(
    make_policy: Callable[[], Any],
    *,
    host: str = "127.0.0.1",
    port: int = 8765,
    at_once: int = 1,
    on_port: Callable[[int], None] = lambda port: print(f"waiting for trials on port {port}", flush=True),
) -> None:
    """Serve until the process ends.

    Args:
        make_policy: called once for each trial. Its result has ``card`` (a dict), ``reset(instruction, session)`` and
            ``act(observation)``, and may have ``take_notes()``, which returns a dict that the recording keeps.
        host: address to listen on; 0.0.0.0 for every address of this host. Everyone who reaches the port may use it.
        port: 0 for one that is free.
        at_once: trials that run at the same time; further ones wait.
        on_port: called with the port once it listens.
    """
    slots = threading.Semaphore(at_once)

    def converse(connection: ServerConnection) -> None:
        _converse(make_policy, connection, slots)

    with _listen(converse, host, port, compression=None, ping_interval=None, max_size=MAX_MESSAGE_BYTES) as server:
        on_port(server.socket.getsockname()[1])
        server.serve_forever()


def decode(frame: bytes) -> Any:
    """Return a message with its arrays as numpy arrays, which can be written to."""
    return msgpack.unpackb(frame, object_hook=_array_from_map)


def encode(message: Any) -> bytes:
    """Return a message whose numpy arrays and numbers are those of the wire."""
    return msgpack.packb(message, default=_plain)


def actions_of(answer: Any) -> list[dict[str, Any]]:
    """Return what ``act`` answered as the list of actions that the wire carries.

    Args:
        answer: one pose (7,), poses (n, 7), one dict, or a list of poses and dicts.

    Raises:
        ValueError: the answer has another type or shape.
    """
    if isinstance(answer, dict):
        return [answer]
    if not isinstance(answer, np.ndarray) and any(isinstance(one, dict) for one in answer):
        return [one if isinstance(one, dict) else {"pose_tcp_in_base": _poses(one)[0]} for one in answer]
    return [{"pose_tcp_in_base": pose} for pose in _poses(answer)]


def _poses(values: Any) -> list[list[float]]:
    poses = np.atleast_2d(np.asarray(values, dtype=np.float64))
    if poses.ndim != 2 or poses.shape[1] != 7 or not len(poses):
        raise ValueError(
            f"act: expected poses (n, 7) of x y z [m] and quaternion w x y z, or dicts, got shape {np.shape(values)}"
        )
    return poses.tolist()


def _converse(make_policy: Callable[[], Any], connection: ServerConnection, slots: threading.Semaphore) -> None:
    policy = None
    try:
        policy = make_policy()
        # Before the slot: a trial that waits for its turn knows that somebody is there.
        connection.send(encode({"type": "card", "card": policy.card}))
        with slots:
            views: dict[str, Any] = {}
            for frame in connection:
                message = decode(frame)
                if message["type"] == "close":
                    return
                connection.send(encode(_answer(policy, message, views)))
    except ConnectionClosed:
        return  # the trial ended without this policy
    except Exception:
        trace = traceback.format_exc()
        print(trace, flush=True)
        said = {"type": "error", "kind": "exception", "message": trace[-TRACEBACK_CHARS:]}
        connection.send(encode({**said, **_notes(policy)}))


def _answer(policy: Any, message: dict[str, Any], views: dict[str, Any]) -> dict[str, Any]:
    """``views``: the last view of each camera, with its time; an observation brings those that are new."""
    if message["type"] == "reset":
        views.clear()
        policy.reset(message["instruction"], message["session"])
        return {"type": "ready"}
    observation = message["observation"]
    views |= {name: {**view, "sim_time_s": observation["sim_time_s"]} for name, view in observation["cameras"].items()}
    actions = actions_of(policy.act({**observation, "cameras": dict(views)}))
    return {"type": "actions", "actions": actions, **_notes(policy)}


def _notes(policy: Any) -> dict[str, Any]:
    take = getattr(policy, "take_notes", None)
    notes = take() if take is not None else None
    return {"notes": notes} if notes else {}


def _array_from_map(entries: dict[str, Any]) -> Any:
    if "__ndarray__" not in entries:
        return entries
    return np.frombuffer(entries["data"], entries["dtype"]).reshape(entries["shape"]).copy()


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        little = value.astype(value.dtype.newbyteorder("<"), order="C")
        return {"__ndarray__": True, "dtype": little.dtype.str, "shape": list(value.shape), "data": little.tobytes()}
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"a {type(value).__name__} cannot be sent; send lists, dicts, numbers, text or numpy arrays")

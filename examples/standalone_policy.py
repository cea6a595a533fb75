"""A policy in an environment of its own, which needs only websockets, msgpack and numpy. Copy this file and change it.

    python standalone_policy.py                                         # in the policy's environment
    carecontact check ws://127.0.0.1:8765                               # in the environment of carecontact
    carecontact run --policy ws://127.0.0.1:8765 --out runs/standalone

docs/your-policy.md of carecontact describes every message.
"""

import traceback

import msgpack
import numpy as np
from websockets.sync.server import serve

CARD = {
    "name": "standalone",
    "modalities": ["rgb", "depth", "landmarks"],
    "cameras": ["overhead"],
    "control_hz": 10,
}
WRIST = 16
"""The right wrist among the 33 landmarks of MediaPipe Pose."""


class Policy:
    """One object for each trial."""

    def reset(self, instruction, session):
        self.instruction = instruction
        self.low = np.array(session["action_bounds"]["workspace_low_m"])
        self.high = np.array(session["action_bounds"]["workspace_high_m"])

    def act(self, observation):
        """Move to 0.2 m above the right wrist in four seconds, then end the trial."""
        tool = observation["pose_tcp_in_base"]
        wrist = observation["cameras"]["overhead"]["landmarks_in_base"][WRIST]
        if not np.isfinite(wrist).all():
            return [{"done": True}]
        goal = np.clip(wrist + [0, 0, 0.2], self.low, self.high)
        way = [(1 - s) * tool[:3] + s * goal for s in np.linspace(0, 1, 41)[1:]]
        return [*({"pose_tcp_in_base": [*place, *tool[3:]]} for place in way), {"done": True}]


def decode_array(entries):
    """Arrays arrive as maps; everything else stays as it is."""
    if "__ndarray__" not in entries:
        return entries
    return np.frombuffer(entries["data"], entries["dtype"]).reshape(entries["shape"])


def plain(value):
    """Numbers of numpy become numbers of Python, which msgpack can pack."""
    return value.tolist() if hasattr(value, "tolist") else value


def answer(policy, message):
    if message["type"] == "reset":
        policy.reset(message["instruction"], message["session"])
        return {"type": "ready"}
    return {"type": "actions", "actions": policy.act(message["observation"])}


def converse(connection):
    """Every trial is a connection: the card first, then an answer to each message until the trial closes it."""
    policy = Policy()
    connection.send(msgpack.packb({"type": "card", "card": CARD}))
    for frame in connection:
        message = msgpack.unpackb(frame, object_hook=decode_array)
        if message["type"] == "close":
            return
        try:
            reply = msgpack.packb(answer(policy, message), default=plain)
        except Exception:
            connection.send(msgpack.packb({"type": "error", "kind": "exception", "message": traceback.format_exc()}))
            raise
        connection.send(reply)


if __name__ == "__main__":
    with serve(converse, "127.0.0.1", 8765, max_size=None, compression=None) as server:
        server.serve_forever()

"""A policy whose model answers several trials at once: one call for all observations that wait.

    python batching_server.py                                                   # in the policy's environment
    carecontact run --policy ws://127.0.0.1:8765 --jobs 8 --out runs/batched    # eight trials, eight connections

Every trial has a connection of its own, so that `--jobs` is the largest batch. docs/your-policy.md of carecontact
describes every message; it needs only websockets, msgpack and numpy.
"""

import argparse
import queue
import threading
import traceback
from concurrent.futures import Future

import msgpack
import numpy as np
from websockets.sync.server import serve

CARD = {"name": "batched", "modalities": [], "cameras": [], "control_hz": 10}
WAIT_S = 0.02
"""For further observations, after the first of a batch."""


def act_together(observations):
    """Stands for a model's forward pass: a list of observations in, a list of chunks of actions out."""
    tools = np.stack([observation["pose_tcp_in_base"] for observation in observations])
    goals = tools + [0, 0, 0.005, 0, 0, 0, 0]
    return [[{"pose_tcp_in_base": goal.tolist()}] for goal in goals]


class Batches:
    """Collects what the connections' threads ask, and answers it in one thread."""

    def __init__(self, most):
        self.most, self.asked, self.sizes = most, queue.Queue(), []
        threading.Thread(target=self.answer, daemon=True).start()

    def ask(self, observation):
        future = Future()
        self.asked.put((observation, future))
        return future.result()

    def answer(self):
        while True:
            batch = [self.asked.get()]
            while len(batch) < self.most:
                try:
                    batch.append(self.asked.get(timeout=WAIT_S))
                except queue.Empty:
                    break
            self.sizes.append(len(batch))
            try:
                chunks = act_together([observation for observation, _ in batch])
            except Exception as error:
                for _, future in batch:
                    future.set_exception(error)
                continue
            for (_, future), chunk in zip(batch, chunks, strict=True):
                future.set_result(chunk)


def decode_array(entries):
    """Arrays arrive as maps; everything else stays as it is."""
    if "__ndarray__" not in entries:
        return entries
    return np.frombuffer(entries["data"], entries["dtype"]).reshape(entries["shape"])


def converse(connection, batches):
    """Every trial is a connection: the card first, then an answer to each message until the trial closes it."""
    connection.send(msgpack.packb({"type": "card", "card": CARD}))
    for frame in connection:
        message = msgpack.unpackb(frame, object_hook=decode_array)
        if message["type"] == "close":
            break
        if message["type"] == "reset":
            connection.send(msgpack.packb({"type": "ready"}))
            continue
        try:
            reply = {"type": "actions", "actions": batches.ask(message["observation"])}
        except Exception:
            reply = {"type": "error", "kind": "exception", "message": traceback.format_exc()}
        connection.send(msgpack.packb(reply))
    if batches.sizes:
        print(f"{len(batches.sizes)} batches of {np.mean(batches.sizes):.2f} observations on average", flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--port", type=int, default=8765)
    parser.add_argument("--most", type=int, default=8, help="observations in a batch")
    options = parser.parse_args()
    shared = Batches(options.most)
    with serve(
        lambda connection: converse(connection, shared), "127.0.0.1", options.port, max_size=None, compression=None
    ) as server:
        print(f"serving on port {server.socket.getsockname()[1]}", flush=True)
        server.serve_forever()

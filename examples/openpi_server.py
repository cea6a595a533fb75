"""A server on the wire of openpi, which needs only websockets, msgpack and numpy. Copy this file and change `infer`.

    python openpi_server.py                                             # in the policy's environment
    carecontact check "openpi://127.0.0.1:8000?profile=pi05-droid"      # in the environment of carecontact

As it stands, the answer is a constant, so the check warns that every input is without effect.
docs/vla.md of carecontact says what a request holds. openpi's own client can talk to this server, too.
"""

import http
import sys
import time
import traceback

import msgpack
import numpy as np
from websockets.sync.server import serve


def infer(request):
    """Return (15, 8): steps at 15 Hz, each of seven normalised joint velocities and the gripper (1 is closed)."""
    camera = request["observation/exterior_image_1_left"]
    assert camera.shape == (224, 224, 3)
    posture = request["observation/joint_position"]
    print(f"{request['prompt']!r} at joint angles {np.round(posture, 2)}")
    actions = np.zeros((15, 8), np.float32)
    actions[:, 5] = 0.05
    return {"actions": actions}


def encode(value):
    """Marks of openpi for arrays and for numpy's numbers: their keys are bytes."""
    if isinstance(value, np.ndarray):
        return {b"__ndarray__": True, b"data": value.tobytes(), b"dtype": value.dtype.str, b"shape": value.shape}
    return {b"__npgeneric__": True, b"data": value.item(), b"dtype": value.dtype.str}


def decode(entries):
    if b"__ndarray__" in entries:
        return np.frombuffer(entries[b"data"], entries[b"dtype"]).reshape(entries[b"shape"])
    return np.dtype(entries[b"dtype"]).type(entries[b"data"]) if b"__npgeneric__" in entries else entries


def converse(connection):
    """Metadata first, which openpi leaves empty for DROID; then one answer for each request."""
    connection.send(msgpack.packb({}))
    for frame in connection:
        try:
            started = time.monotonic()
            answer = infer(msgpack.unpackb(frame, object_hook=decode))
            answer["server_timing"] = {"infer_ms": 1000 * (time.monotonic() - started)}
            connection.send(msgpack.packb(answer, default=encode))
        except Exception:
            connection.send(traceback.format_exc())  # a text frame is an error
            connection.close(1011)
            raise


def health(connection, request):
    return connection.respond(http.HTTPStatus.OK, "OK\n") if request.path == "/healthz" else None


if __name__ == "__main__":
    port = int(sys.argv[1]) if len(sys.argv) > 1 else 8000
    with serve(converse, "127.0.0.1", port, max_size=None, compression=None, process_request=health) as server:
        print(f"serving on port {server.socket.getsockname()[1]}", flush=True)
        server.serve_forever()

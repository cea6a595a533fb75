"""A peer that does on its line what it should not: ``python -m tests.serving.hostile`` prints its port.

A client names the stage and the attack in the path, as in ``/act/ping-flood``; until that stage the peer behaves well.
"""

from __future__ import annotations

import base64
import hashlib
import random
import socket
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

from carecontact.serving.packing import pack

STAGES = ("connect", "card", "reset", "act", "close")
CARD = pack({"type": "card", "card": {"name": "hostile", "modalities": [], "cameras": []}})
ANSWERS = {
    "card": CARD,
    "reset": pack({"type": "ready"}),
    "act": pack({"type": "actions", "actions": [{"pose_tcp_in_base": [0.4, 0.0, 0.4, 0.0, 1.0, 0.0, 0.0]}]}),
}
TEXT, BINARY, CONTINUED, CLOSE, PING = 1, 2, 0, 8, 9
LASTS_S = 60.0
"""Longer than any deadline of the tests."""
DRIP_S = 0.2
SWITCH = (
    b"HTTP/1.1 101 Switching Protocols\r\nUpgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Accept: %s\r\n\r\n"
)


def frame(opcode: int, payload: bytes = b"", *, fin: bool = True, length: int | None = None) -> bytes:
    """``length``: what the frame claims to hold, in place of the length of its payload."""
    size = len(payload) if length is None else length
    head = bytes([opcode | (0x80 if fin else 0)])
    if size < 126:
        return head + bytes([size]) + payload
    if size < 1 << 16:
        return head + b"\x7e" + struct.pack("!H", size) + payload
    return head + b"\x7f" + struct.pack("!Q", size) + payload


def silence(line: socket.socket, answer: bytes) -> None:
    time.sleep(LASTS_S)


def flood(line: socket.socket, piece: bytes) -> None:
    """Never reads."""
    until = time.monotonic() + LASTS_S
    while time.monotonic() < until:
        line.sendall(piece)


def drip(line: socket.socket, message: bytes) -> None:
    for k in range(len(message)):
        line.sendall(message[k : k + 1])
        time.sleep(DRIP_S)
    time.sleep(LASTS_S)


def pings_read(line: socket.socket, answer: bytes) -> None:
    line.setblocking(False)
    until = time.monotonic() + LASTS_S
    pings = frame(PING, bytes(125)) * 100
    while time.monotonic() < until:
        with suppress(BlockingIOError):
            line.send(pings)
        with suppress(BlockingIOError):
            if not line.recv(1 << 16):
                return
        time.sleep(0.001)


def then(first: bytes, second: Callable[[socket.socket, bytes], None], piece: bytes = b"") -> Attack:
    def attack(line: socket.socket, answer: bytes) -> None:
        line.sendall(first)
        second(line, piece or answer)

    return attack


def half_close(how: int) -> Attack:
    def attack(line: socket.socket, answer: bytes) -> None:
        line.shutdown(how)
        time.sleep(LASTS_S)

    return attack


def reset_line(line: socket.socket, answer: bytes) -> None:
    line.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    line.close()


def noise(line: socket.socket, answer: bytes) -> None:
    line.sendall(random.Random(answer).randbytes(4096))
    time.sleep(LASTS_S)


Attack = Callable[[socket.socket, bytes], None]
PINGS = frame(PING, bytes(125)) * 500
MANY_VALUES = b"\xdc\x04\x00" + 1024 * (b"\xdc\x0f\xf0" + 4080 * b"\x80")
"""4 MB of msgpack: empty maps in lists."""
ATTACKS: dict[str, Attack] = {
    "silence": silence,
    "ping-flood": lambda line, _: flood(line, PINGS),
    "ping-flood-read": pings_read,
    "drip": lambda line, answer: drip(line, frame(BINARY, answer)),
    "drip-of-pings": lambda line, _: drip(line, frame(PING, b"x") * 1000),
    "half-close-write": half_close(socket.SHUT_WR),
    "half-close-read": half_close(socket.SHUT_RD),
    "reset": reset_line,
    "noise": noise,
    "200-mb-announced": then(frame(BINARY, length=200 << 20), silence),
    "200-mb-sent": then(frame(BINARY, length=200 << 20), flood, bytes(1 << 20)),
    "1-gb-sent": then(frame(BINARY, length=1 << 30), flood, bytes(1 << 20)),
    "just-allowed": then(frame(BINARY, length=4 << 20), silence),
    "fragments": then(frame(BINARY, b"x", fin=False), flood, frame(CONTINUED, b"x", fin=False) * 2000),
    "empty-fragments": then(frame(BINARY, fin=False), flood, frame(CONTINUED, fin=False) * 2000),
    "message-flood": lambda line, _: flood(line, frame(BINARY, b"\x80") * 2000),
    "large-message-flood": lambda line, _: flood(line, frame(BINARY, bytes(4 << 20))),
    "many-values": then(frame(BINARY, MANY_VALUES), silence),
    "text-not-utf8-and-pings": then(frame(TEXT, b"\xff\xfe"), flood, PINGS),
    "fragments-and-pings": then(frame(BINARY, fin=False) + frame(CONTINUED, fin=False) * 5000, flood, PINGS),
    "close-and-pings": then(frame(CLOSE, b"\x03\xe8"), flood, PINGS),
    "close-and-silence": then(frame(CLOSE, b"\x03\xe8"), silence),
    "reserved-opcode-and-pings": then(frame(3), flood, PINGS),
    "masked-and-silence": then(b"\x82\x81\x00\x00\x00\x00x", silence),
    "long-ping": then(frame(PING, bytes(200)), flood, PINGS),
}
HANDSHAKES: dict[str, Attack] = {
    "silence": silence,
    "drip": lambda line, switch: drip(line, switch),
    "endless-header": lambda line, _: flood(line, b"x" * 4096),
    "endless-headers": then(b"HTTP/1.1 101 OK\r\n", flood, b"a: b\r\n" * 500),
    "endless-body": then(b"HTTP/1.1 200 OK\r\n\r\n", flood, bytes(1 << 16)),
    "1-gb-body": then(b"HTTP/1.1 500 No\r\nContent-Length: 1073741824\r\n\r\n", flood, bytes(1 << 16)),
    "redirect": then(b"HTTP/1.1 302 Found\r\nLocation: ws://127.0.0.1:1/\r\nContent-Length: 0\r\n\r\n", silence),
    "half-close-write": half_close(socket.SHUT_WR),
    "half-close-read": half_close(socket.SHUT_RD),
    "reset": reset_line,
    "noise": noise,
}


def attacks_at(stage: str) -> list[str]:
    return list(HANDSHAKES if stage == "connect" else ATTACKS)


def meet(line: socket.socket) -> None:
    """One connection: well-behaved until the stage that the path names."""
    request = b""
    while not request.endswith(b"\r\n\r\n"):
        request += line.recv(4096)
    _, stage, attack = request.split()[1].decode().split("/")
    key = next(row.split()[1] for row in request.split(b"\r\n") if row.lower().startswith(b"sec-websocket-key"))
    accept = hashlib.sha1(key + b"258EAFA5-E914-47DA-95CA-C5AB0DC85B11").digest()
    switch = SWITCH % base64.b64encode(accept)
    if stage == "connect":
        HANDSHAKES[attack](line, switch)
        return
    line.sendall(switch)
    # A close is attacked as soon as the last answer is out; the others in place of their answer.
    for before in ("card", "reset", "act"):
        if before != "card" and before != stage:
            read_frame(line)
        if before == stage:
            ATTACKS[attack](line, ANSWERS[before])
            return
        line.sendall(frame(BINARY, ANSWERS[before]))
    ATTACKS[attack](line, ANSWERS["act"])


def read_frame(line: socket.socket) -> None:
    length = exactly(line, 2)[1] & 0x7F
    if length >= 126:
        length = int.from_bytes(exactly(line, 2 if length == 126 else 8), "big")
    exactly(line, 4 + length)


def exactly(line: socket.socket, count: int) -> bytes:
    got = b""
    while len(got) < count:
        piece = line.recv(count - len(got))
        if not piece:
            raise ConnectionError
        got += piece
    return got


def serve() -> None:
    def one(line: socket.socket) -> None:
        with suppress(OSError), line:
            meet(line)

    with socket.create_server(("127.0.0.1", 0), backlog=1000) as listening:
        sys.stdout.write(f"{listening.getsockname()[1]}\n")
        sys.stdout.flush()
        while True:
            threading.Thread(target=one, args=(listening.accept()[0],), daemon=True).start()


@contextmanager
def hostile_server() -> Iterator[int]:
    """The port of one in a process of its own, so that its floods take no time from the client's interpreter."""
    process = subprocess.Popen([sys.executable, "-m", "tests.serving.hostile"], stdout=subprocess.PIPE)
    assert process.stdout is not None
    try:
        yield int(process.stdout.readline())
    finally:
        process.kill()
        process.wait()
        process.stdout.close()


if __name__ == "__main__":
    serve()

"""Frames spoilt at one layer each, from a seeded generator; every one comes with the layer's name."""

from __future__ import annotations

import copy
import math
import random
from collections.abc import Callable, Iterator
from typing import Any

import msgpack
import numpy as np
from websockets.frames import CloseCode, Frame, Opcode

from carecontact.interface.action import MAX_CHUNK, Action
from carecontact.interface.policy import PolicyCard
from carecontact.serving import codec
from carecontact.serving.packing import MAX_ITEMS, MAX_TEXT_BYTES, pack
from tests.policies.synthetic import SESSION, synthetic_observation, synthetic_view

Plain = dict[str, Any]
LAYERS = ("transport", "msgpack", "schema", "dtype", "shape", "value")
ODD_VALUES = (None, True, -1, 2**63 - 1, 0.5, "", "x" * 99, b"\x00\xff", [], {}, [[]], {"a": {}}, [1, [2, [3]]])
ODD_NUMBERS = (np.nan, np.inf, -np.inf, 1e308, -1e308, 2**64 - 1, -(2**63), 9.0)
ODD_DTYPES = ("|O", "<U4", "<c16", "<M8[s]", ">f8", "<f8,<f8", "f8", "<f16", "", "|V8", 3, None, ["<f8"], {"a": 1})
ODD_SHAPES = (
    [],
    [0],
    [6],
    [8],
    [7, 1],
    [1, 7],
    [-7],
    [7.0],
    [True] * 7,
    [1 << 40],
    [1] * 9,
    "7",
    None,
    [[7]],
    [2**63, 2],
)


def replies() -> dict[str, Plain]:
    """Well-formed messages of a policy, one of each kind."""
    chunk = [
        Action(pose_tcp_in_base=np.array([0.4, 0.0, 0.4, 0.0, 1.0, 0.0, 0.0]), stiffness=(400.0, 20.0), gripper=0.5),
        Action(done=True),
    ]
    card = PolicyCard(name="fuzz", modalities=("rgb", "masks"), cameras=("overhead",), control_hz=10)
    return {
        "actions": {"type": "actions", "actions": codec.encode_actions(chunk)},
        "card": {"type": "card", "card": codec.encode_card(card)},
        "ready": {"type": "ready"},
        "error": {"type": "error", "kind": "exception", "message": "why"},
    }


def requests() -> dict[str, Plain]:
    """Well-formed messages to a policy."""
    view = synthetic_view(height=2, width=3, points=2)
    observation = synthetic_observation(cameras={"overhead": view})
    return {
        "act": {"type": "act", "observation": codec.encode_observation(observation)},
        "reset": {"type": "reset", "instruction": "touch", "session": codec.encode_session(SESSION)},
    }


def spoilt(message: Plain, layer: str, rng: random.Random, *, packer: Callable[[Any], bytes] = msgpack.packb) -> bytes:
    """The packed message with one fault at a layer above the transport.

    ``packer``: of a message in which arrays are maps as the native wire has them.
    """
    plain = _maps_for_arrays(copy.deepcopy(message))
    if layer == "msgpack":
        return _spoilt_bytes(packer(plain), rng)
    {"schema": _spoil_schema, "dtype": _spoil_dtype, "shape": _spoil_shape, "value": _spoil_value}[layer](plain, rng)
    return packer(plain)


def framed(payload: bytes, opcode: Opcode = Opcode.BINARY, *, fin: bool = True) -> bytes:
    """As a server sends it."""
    return Frame(opcode, payload, fin).serialize(mask=False)


def spoilt_transport(payload: bytes, rng: random.Random) -> bytes:
    """Raw bytes on the socket in place of the frame that carries ``payload``."""
    whole = framed(payload)
    cut = rng.randrange(len(payload) + 1)
    halves = payload[:cut], payload[cut:]
    choices: list[Callable[[], bytes]] = [
        lambda: whole[: rng.randrange(len(whole))],
        lambda: rng.randbytes(rng.randint(1, 60)),
        lambda: _flipped(whole, rng, within=4),
        lambda: framed(payload, Opcode.TEXT),
        lambda: framed(b"\xff\xfe" + payload, Opcode.TEXT),
        lambda: bytes([whole[0] | rng.choice((0x40, 0x20, 0x10))]) + whole[1:],
        lambda: bytes([0x80 | rng.choice((3, 4, 5, 6, 7, 11, 12, 13, 14, 15))]) + whole[1:],
        lambda: Frame(Opcode.BINARY, payload).serialize(mask=True),
        lambda: b"\x82\x7f" + rng.choice((2**63, 2**62, 2**40, 5 << 20)).to_bytes(8, "big") + payload,
        lambda: framed(halves[0], fin=False) + framed(halves[1], Opcode.CONT),
        lambda: framed(halves[0], fin=False) + framed(halves[1]),
        lambda: framed(halves[0], fin=False),
        lambda: framed(payload, Opcode.CONT),
        lambda: framed(b"p" * rng.randint(0, 125), Opcode.PING) * rng.randint(1, 40) + whole,
        lambda: b"\x89\x7e\x00\xff" + b"p" * 255 + whole,
        lambda: b"\x09\x01p" + whole,
        lambda: framed(b"late", Opcode.PONG) + whole,
        lambda: framed(int(rng.choice(list(CloseCode))).to_bytes(2, "big") + b"why", Opcode.CLOSE),
        lambda: framed(rng.randint(0, 65535).to_bytes(2, "big") + rng.randbytes(9), Opcode.CLOSE),
        lambda: framed(b"\x03", Opcode.CLOSE),
        lambda: b"HTTP/1.1 200 OK\r\n\r\n" + whole,
        lambda: b"",
    ]
    return rng.choice(choices)()


def _spoilt_bytes(data: bytes, rng: random.Random) -> bytes:
    deep = rng.randint(9, 4000)
    choices: list[Callable[[], bytes]] = [
        lambda: _flipped(data, rng, within=len(data)),
        lambda: data[: rng.randrange(len(data))],
        lambda: data + rng.randbytes(rng.randint(1, 9)),
        lambda: _inserted(data, rng),
        lambda: rng.randbytes(rng.randint(0, 80)),
        lambda: b"\x91" * deep + b"\xc0",
        lambda: b"\x81\xa1a" * deep + b"\xc0",
        lambda: rng.choice((b"\xdd", b"\xdf", b"\xc6", b"\xdb", b"\xc9")) + b"\xff\xff\xff\xff" + data,
        lambda: b"\xd4" + rng.randbytes(2) if rng.random() < 0.5 else b"\xc7\x05" + rng.randbytes(6),
        lambda: b"\x82\xa4type\xa5ready\xa4type\xa5ready",
        lambda: b"\x81\x01\x02",
        lambda: msgpack.packb(["x"] * (MAX_ITEMS + 1)),
        lambda: msgpack.packb({"type": "x" * (MAX_TEXT_BYTES + 1)}),
        lambda: b"\xa2\xc3\x28",
    ]
    return rng.choice(choices)()


def _spoil_schema(plain: Plain, rng: random.Random) -> None:
    """A key too many, too few or by another name, or something quite different where a map or list was."""
    holder, key = rng.choice(list(_places(plain)))
    target = holder[key] if isinstance(holder[key], dict) and rng.random() < 0.5 else holder
    if not isinstance(target, dict):
        target[key] = rng.choice(ODD_VALUES)
        return
    match rng.randrange(4):
        case 0:
            target[rng.choice(("contact_force", "seed", "torque", "", "__ndarray__", "x" * 300))] = 1.5
        case 1 if target:
            del target[rng.choice(list(target))]
        case 2 if target:
            name = rng.choice(list(target))
            target[f"{name}_"] = target.pop(name)
        case _:
            holder[key] = rng.choice(ODD_VALUES)


def _spoil_dtype(plain: Plain, rng: random.Random) -> None:
    """An array of another kind of number, or text, bytes or nothing in place of a number."""
    arrays = [h[k] for h, k in _places(plain) if _is_array(h[k])]
    if arrays and rng.random() < 0.7:
        array = rng.choice(arrays)
        if rng.random() < 0.6:
            array["dtype"] = rng.choice(ODD_DTYPES)
            return
        kind = np.dtype(rng.choice(("|b1", "|u1", "<i2", "<u4", "<i8", "<f2", "<f4", "<f8")))
        count = math.prod(array["shape"])
        array["dtype"], array["data"] = kind.str, rng.randbytes(count * kind.itemsize)
        return
    leaves = [(h, k) for h, k in _places(plain) if isinstance(h[k], int | float | str) or h[k] is None]
    holder, key = rng.choice(leaves)
    holder[key] = rng.choice([v for v in ODD_VALUES if type(v) is not type(holder[key])])


def _spoil_shape(plain: Plain, rng: random.Random) -> None:
    """An array whose shape is odd or does not fit its data, or a list of another length."""
    arrays = [h[k] for h, k in _places(plain) if _is_array(h[k])]
    lists = [h[k] for h, k in _places(plain) if isinstance(h[k], list)]
    if arrays and (not lists or rng.random() < 0.6):
        array = rng.choice(arrays)
        match rng.randrange(3):
            case 0:
                array["shape"] = rng.choice(ODD_SHAPES)
            case 1:
                array["data"] = array["data"][: rng.randrange(len(array["data"]) + 1)] + rng.randbytes(
                    rng.randint(0, 9)
                )
            case _:
                sizes = [rng.randint(0, 9) for _ in range(rng.randint(0, 4))]
                count = math.prod(sizes) * np.dtype(array["dtype"]).itemsize
                array["shape"], array["data"] = sizes, bytes(count)
        return
    if not lists:
        plain["actions"] = []
        return
    entries = rng.choice(lists)
    match rng.randrange(3):
        case 0:
            entries.clear()
        case 1:
            entries.extend(entries * rng.randint(1, 3) or [1.0])
        case _:
            entries.extend((entries[:1] or [0]) * rng.choice((MAX_CHUNK, MAX_ITEMS)))


def _spoil_value(plain: Plain, rng: random.Random) -> None:
    """A number that is none, is endless or lies outside what is allowed; unknown text."""
    arrays = [h[k] for h, k in _places(plain) if _is_array(h[k]) and h[k]["dtype"] == "<f8" and h[k]["data"]]
    if arrays and rng.random() < 0.5:
        array = rng.choice(arrays)
        numbers = np.frombuffer(array["data"], "<f8").copy()
        for _ in range(rng.randint(1, 3)):
            numbers[rng.randrange(len(numbers))] = float(rng.choice(ODD_NUMBERS))
        array["data"] = numbers.tobytes()
        return
    leaves = [(h, k) for h, k in _places(plain) if type(h[k]) in (int, float, str)]
    holder, key = rng.choice(leaves)
    if isinstance(holder[key], str):
        holder[key] = rng.choice(("", "\x00", "../../etc", "T1-s003", "x" * 70000, "é" * 9, "oversize", "observation"))
    else:
        holder[key] = rng.choice(ODD_NUMBERS)


def _places(value: Any) -> Iterator[tuple[Any, Any]]:
    """Every (map or list, key) of a message, arrays as one place."""
    if not isinstance(value, dict | list) or _is_array(value):
        return
    for key in list(value) if isinstance(value, dict) else range(len(value)):
        yield value, key
        yield from _places(value[key])


def _maps_for_arrays(value: Any) -> Any:
    """As they travel, so that what an array says of itself can be spoilt."""
    return msgpack.unpackb(pack(value), raw=False)


def _is_array(value: Any) -> bool:
    return isinstance(value, dict) and "__ndarray__" in value and isinstance(value.get("data"), bytes)


def _flipped(data: bytes, rng: random.Random, *, within: int) -> bytes:
    piece = bytearray(data)
    for _ in range(rng.randint(1, 3)):
        piece[rng.randrange(min(within, len(piece)))] ^= 1 << rng.randrange(8)
    return bytes(piece)


def _inserted(data: bytes, rng: random.Random) -> bytes:
    at = rng.randrange(len(data) + 1)
    return data[:at] + rng.randbytes(rng.randint(1, 9)) + data[at:]

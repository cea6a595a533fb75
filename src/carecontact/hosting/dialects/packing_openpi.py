"""openpi's packing: msgpack in which an array is a map with *bytes* as keys, decoded as strictly as the native wire's.

An array is ``{b"__ndarray__": true, b"data": <bin>, b"dtype": "<f4", b"shape": [15, 8]}``, a scalar of numpy
``{b"__npgeneric__": true, b"data": 0.5, b"dtype": "<f4"}``. The layout is that of openpi-client 0.1.2, module
msgpack_numpy.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import cast

import msgpack  # pyright: ignore[reportMissingTypeStubs]
import numpy as np

from carecontact.errors import ContractError
from carecontact.hosting.wire.packing import (
    DTYPES,
    MAX_DEPTH,
    MAX_REPLY_BYTES,
    array_of,
    is_array,
    is_list,
    is_map,
    msgpack_of,
)

ARRAY, SCALAR = b"__ndarray__", b"__npgeneric__"
KEYS = {ARRAY: {ARRAY, b"data", b"dtype", b"shape"}, SCALAR: {SCALAR, b"data", b"dtype"}}
"""Marker -> the keys of a map with this marker, which stands for an array or a scalar of numpy."""

_packb = cast(Callable[..., bytes], msgpack.packb)  # pyright: ignore[reportUnknownMemberType]


def pack(value: object) -> bytes:
    """Encode maps with text keys, lists, numbers, text, None and numeric arrays. Equal values give equal bytes.

    Raises ContractError for anything else.
    """
    try:
        return _packb(value, default=_to_map)
    except (TypeError, ValueError, OverflowError, RecursionError) as error:
        raise ContractError(f"message: expected what can be sent, got what cannot be encoded: {error}") from None


def unpack(data: bytes, *, max_bytes: int = MAX_REPLY_BYTES) -> object:
    """Decode one message. Arrays come back read only, scalars of numpy as numbers.

    Raises ContractError: not msgpack, trailing bytes, a size, depth or count over its bound, a repeated key, a key that
    is neither text nor one of an array, an array whose dtype is not one of DTYPES or whose data does not fill its
    shape.
    """
    return _with_arrays(msgpack_of(data, max_bytes=max_bytes, pairs=_map), depth=0, place="message")


def _to_map(value: object) -> object:
    if is_array(value):
        if value.dtype.str not in DTYPES:
            raise TypeError(f"array dtype {value.dtype}; valid: {', '.join(DTYPES)}")
        return {ARRAY: True, b"data": value.tobytes(), b"dtype": value.dtype.str, b"shape": list(value.shape)}
    raise TypeError(f"a {type(value).__name__} has no place in a message")


def _map(pairs: list[tuple[object, object]]) -> dict[object, object]:
    entries = dict(pairs)
    if len(entries) != len(pairs):
        raise ContractError("message: expected each key of a map once, got one of them again")
    for marker, keys in KEYS.items():
        if marker in entries:
            if set(entries) != keys or entries[marker] is not True:
                raise ContractError(f"message: expected {marker!r} with the keys {sorted(keys)}, got {pairs!r:.200}")
            return entries
    for key in entries:
        if not isinstance(key, str):
            raise ContractError(f"message: expected text as keys outside arrays, got {key!r:.80}")
        if key.encode() in KEYS:
            hint = "pack with openpi_client.msgpack_numpy, which packs its own keys as bytes"
            raise ContractError(f"message: expected {key.encode()!r} as the mark of an array, got text; {hint}")
    return entries


def _with_arrays(value: object, *, depth: int, place: str) -> object:
    if depth > MAX_DEPTH:
        raise ContractError(f"{place:.80}: expected at most {MAX_DEPTH} levels, got a deeper one")
    if is_map(value):
        entries = cast(dict[object, object], value)
        if ARRAY in entries:
            return array_of(entries[b"dtype"], entries[b"shape"], entries[b"data"], place=place)
        if SCALAR in entries:
            return _number(entries[b"data"], entries[b"dtype"], place)
        return {k: _with_arrays(v, depth=depth + 1, place=f"{place}.{k:.80}") for k, v in value.items()}
    if is_list(value):
        return [_with_arrays(v, depth=depth + 1, place=f"{place}[{i}]") for i, v in enumerate(value)]
    return value


def _number(data: object, dtype: object, place: str) -> object:
    if dtype not in DTYPES or not isinstance(data, bool | int | float):
        raise ContractError(
            f"{place}: expected a number of one of {', '.join(DTYPES)}, got {data!r:.80} of {dtype!r:.80}"
        )
    try:
        with np.errstate(over="ignore"):
            return cast(object, np.dtype(cast(str, dtype)).type(data).item())
    except OverflowError:
        raise ContractError(f"{place}: expected a number of {dtype}, got {data!r:.80}") from None

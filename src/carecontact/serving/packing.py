"""Converts plain msgpack values and numeric arrays to bytes and back. Whatever arrives is checked for size and type
before it is used.

An array travels as the map ``{"__ndarray__": true, "dtype": "<f4", "shape": [480, 640], "data": <bin>}``: C order,
little endian. openpi's servers use the same layout with bytes as keys (``OPENPI``).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeGuard, cast

import msgpack  # pyright: ignore[reportMissingTypeStubs]
import numpy as np
import numpy.typing as npt

from carecontact.errors import ContractError

DTYPES = ("|b1", "|u1", "|i1", "<u2", "<i2", "<u4", "<i4", "<u8", "<i8", "<f2", "<f4", "<f8")
MAX_DEPTH = 8
"""The deepest message of the wire, an array of a camera of an observation, has five levels."""
MAX_ITEMS = 4096
"""Most entries of one list or map: above MAX_CHUNK actions, far below what would exhaust memory."""
MAX_VALUES = 1 << 18
"""Most lists, maps and entries in one message: four times those of MAX_CHUNK actions. Without this bound, the 4 million
values that fit into MAX_REPLY_BYTES would take 500 MB and four seconds as Python objects."""
MAX_TEXT_BYTES = 65536
MAX_RANK = 4
MAX_ELEMENTS = 1 << 26
MAX_MESSAGE_BYTES = 256 << 20
"""Largest message from harness to policy: four cameras of 1280x720 with every modality take about 90 MB."""
MAX_REPLY_BYTES = 4 << 20
"""Largest message from policy to harness: a chunk of MAX_CHUNK actions takes about 0.4 MB."""

AnyArray = npt.NDArray[Any]

_packb = cast(Callable[..., bytes], msgpack.packb)  # pyright: ignore[reportUnknownMemberType]
_unpackb = cast(Callable[..., object], msgpack.unpackb)  # pyright: ignore[reportUnknownMemberType]


def is_map(value: object) -> TypeGuard[dict[str, object]]:
    """Whether an unpacked value is a map; the keys of every unpacked map are text."""
    return isinstance(value, dict)


def is_list(value: object) -> TypeGuard[list[object]]:
    return isinstance(value, list)


def is_array(value: object) -> TypeGuard[AnyArray]:
    return isinstance(value, np.ndarray)


ARRAY, SCALAR = "__ndarray__", "__npgeneric__"
"""Keys that mark a map as an array, or as a scalar of numpy."""


@dataclass(frozen=True, kw_only=True)
class Packing:
    """msgpack with one way to write numpy's arrays."""

    order: tuple[str, ...]
    """The keys of an array behind its mark, in the order in which they are written."""
    binary: bool
    """Whether these keys are bytes, and scalars of numpy have a mark, too."""
    remedy: str
    """What helps a server that packs in another way, for an error message."""

    def pack(self, value: object) -> bytes:
        """Encode maps with text keys, lists, numbers, text, None and numeric arrays.

        Raises ContractError for anything else. Equal values give equal bytes.
        """
        try:
            return _packb(value, default=self._plain)
        except (TypeError, ValueError, OverflowError, RecursionError) as error:
            raise ContractError(f"message: expected what can be sent, got what cannot be encoded: {error}") from None

    def unpack(self, data: bytes, *, max_bytes: int = MAX_MESSAGE_BYTES) -> object:
        """Decode one message. Arrays come back as fresh, writable C-ordered arrays, scalars of numpy as numbers.

        Raises ContractError: not msgpack, trailing bytes, a size, depth or count over its bound, a repeated key, a key
        that is neither text nor one of an array, an array whose dtype is not one of DTYPES or whose data does not fill
        its shape.
        """
        return self._with_arrays(_msgpack_of(data, max_bytes=max_bytes), depth=0, place="message")

    def _key(self, name: str) -> str | bytes:
        return name.encode() if self.binary else name

    def _plain(self, value: object) -> object:
        if is_array(value):
            little = value.dtype.newbyteorder("<")
            if little.str not in DTYPES:
                raise TypeError(f"array dtype {value.dtype}; valid: {', '.join(DTYPES)}")
            data = value.astype(little, copy=False).tobytes()
            parts = {ARRAY: True, "dtype": little.str, "shape": list(value.shape), "data": data}
            return {self._key(name): parts[name] for name in (ARRAY, *self.order)}
        if isinstance(value, np.bool_ | np.integer | np.floating):
            return cast(object, value.item())
        raise TypeError(f"a {type(value).__name__} has no place in a message")

    def _with_arrays(self, value: object, *, depth: int, place: str) -> object:
        if depth > MAX_DEPTH:
            raise ContractError(f"{place:.80}: expected at most {MAX_DEPTH} levels, got a deeper one")
        if is_list(value):
            return [self._with_arrays(v, depth=depth + 1, place=f"{place}[{i}]") for i, v in enumerate(value)]
        if not is_map(value):
            return value
        entries = cast(dict[object, object], value)
        if self._key(ARRAY) in entries:
            return _array(place, **self._parts(entries, ARRAY, self.order, place))
        if self.binary and self._key(SCALAR) in entries:
            return _number(place, **self._parts(entries, SCALAR, ("dtype", "data"), place))
        for key in entries:
            if not isinstance(key, str) or (self.binary and key in (ARRAY, SCALAR)):
                raise ContractError(f"{place:.80}: expected text as map keys, got {key!r:.80}; {self.remedy}")
        return {k: self._with_arrays(v, depth=depth + 1, place=f"{place}.{k:.80}") for k, v in value.items()}

    def _parts(self, entries: dict[object, object], mark: str, names: tuple[str, ...], place: str) -> dict[str, object]:
        """Return the entries of a marked map by name. Raises ContractError for other keys."""
        keys = [self._key(name) for name in (mark, *names)]
        if entries.keys() != set(keys) or entries[keys[0]] is not True:
            raise ContractError(f"{place}: expected an array with the keys {keys}, got {list(entries)!s:.200}")
        return {name: entries[self._key(name)] for name in names}


NATIVE = Packing(
    order=("dtype", "shape", "data"),
    binary=False,
    remedy="pack text and not bytes as keys, and send numbers as plain lists",
)
OPENPI = Packing(
    order=("data", "dtype", "shape"),
    binary=True,
    remedy="pack with openpi_client.msgpack_numpy, which packs its own keys as bytes",
)
"""The layout of openpi-client 0.1.2, module msgpack_numpy."""
pack, unpack = NATIVE.pack, NATIVE.unpack


def _msgpack_of(data: bytes, *, max_bytes: int) -> object:
    """Decode msgpack within the bounds of the wire, leaving arrays as maps. Raises ContractError."""
    if len(data) > max_bytes:
        raise ContractError(f"message: expected at most {max_bytes} bytes, got {len(data)}")
    left = MAX_VALUES

    def counted(entries: list[Any]) -> list[Any]:
        nonlocal left
        left -= 1 + len(entries)
        if left < 0:
            raise ContractError(f"message: expected at most {MAX_VALUES} lists, maps and entries of them, got more")
        return entries

    def without_repeats(entries: list[tuple[object, object]]) -> dict[object, object]:
        found: dict[object, object] = {}
        for key, value in counted(entries):
            if key in found:
                raise ContractError(f"message: expected each key of a map once, got {key!r:.80} again")
            found[key] = value
        return found

    try:
        return _unpackb(
            data,
            raw=False,
            strict_map_key=True,
            max_str_len=MAX_TEXT_BYTES,
            max_bin_len=max_bytes,
            max_array_len=MAX_ITEMS,
            max_map_len=MAX_ITEMS,
            max_ext_len=0,
            list_hook=counted,
            object_pairs_hook=without_repeats,
        )
    except ContractError:
        raise
    except Exception as error:
        # Besides ValueError, UnicodeDecodeError and RecursionError, msgpack raises classes of its own, and all of them
        # mean bad bytes. The text of some contains the message itself.
        why = f"{type(error).__name__}: {error}"
        raise ContractError(f"message: expected msgpack, got {len(data)} bytes that are not: {why:.200}") from None


def _array(place: str, *, dtype: object, shape: object, data: object) -> AnyArray:
    if dtype not in DTYPES:
        raise ContractError(f"{place}: expected an array dtype out of {', '.join(DTYPES)}, got {dtype!r:.80}")
    if not is_list(shape) or len(shape) > MAX_RANK:
        raise ContractError(f"{place}: expected a shape of at most {MAX_RANK} sizes, got {shape!r:.80}")
    sizes = [s for s in shape if type(s) is int and 0 <= s <= MAX_ELEMENTS]
    if len(sizes) != len(shape) or math.prod(sizes) > MAX_ELEMENTS:
        raise ContractError(f"{place}: expected a shape of at most {MAX_ELEMENTS} elements, got {shape!r:.80}")
    kind = np.dtype(cast(str, dtype))
    expected = math.prod(sizes) * kind.itemsize
    if not isinstance(data, bytes) or len(data) != expected:
        got = f"{len(data)} bytes" if isinstance(data, bytes) else type(data).__name__
        raise ContractError(f"{place}: expected {expected} bytes for an array {sizes} of {dtype}, got {got}")
    odd = data.translate(None, b"\x00\x01") if dtype == "|b1" else b""
    if odd:
        raise ContractError(f"{place}: expected 0 or 1 in a bool array, got the byte {odd[0]}")
    return np.frombuffer(data, kind).reshape(sizes).copy()


def _number(place: str, *, dtype: object, data: object) -> object:
    if dtype not in DTYPES or not isinstance(data, bool | int | float):
        raise ContractError(
            f"{place}: expected a number of one of {', '.join(DTYPES)}, got {data!r:.80} of {dtype!r:.80}"
        )
    try:
        with np.errstate(over="ignore"):
            return cast(object, np.dtype(cast(str, dtype)).type(data).item())
    except OverflowError:
        raise ContractError(f"{place}: expected a number of {dtype}, got {data!r:.80}") from None

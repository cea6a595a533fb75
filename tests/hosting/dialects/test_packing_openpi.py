"""openpi's packing against bytes that its own client made, and against bytes that nobody should send."""

from __future__ import annotations

import contextlib
import tracemalloc
from pathlib import Path

import msgpack
import numpy as np
import pytest
from hypothesis import given, strategies
from hypothesis.extra import numpy as arrays

from carecontact.errors import ContractError
from carecontact.hosting.dialects.packing_openpi import pack, unpack
from carecontact.hosting.wire.packing import DTYPES, MAX_REPLY_BYTES
from tests.hosting.dialects.given import actions, metadata, request

DATA = Path(__file__).parents[2] / "data" / "openpi"


def test_a_request_has_the_bytes_of_openpis_own_client() -> None:
    assert pack(request()) == (DATA / "request.bin").read_bytes()


@pytest.mark.parametrize("steps", [10, 15])
def test_a_reply_of_openpis_own_packing_is_understood(steps: int) -> None:
    reply = unpack((DATA / f"reply-{steps}.bin").read_bytes())
    assert isinstance(reply, dict)
    assert list(reply) == ["actions", "state", "policy_timing", "server_timing"]
    np.testing.assert_array_equal(reply["actions"], actions(steps), strict=True)
    assert reply["policy_timing"] == {"infer_ms": 41.5}
    with pytest.raises(ValueError, match="read-only"):
        reply["actions"][0] = 0


def test_bare_arrays_and_metadata_are_understood() -> None:
    np.testing.assert_array_equal(unpack((DATA / "bare.bin").read_bytes()), actions(4), strict=True)
    assert unpack((DATA / "metadata.bin").read_bytes()) == {
        "reset_pose": metadata()["reset_pose"], "scale": 0.5, "flag": True
    }  # fmt: skip


def array(**changes: object) -> dict[bytes, object]:
    plain = {b"__ndarray__": True, b"data": bytes(8), b"dtype": "<f4", b"shape": [2]}
    return {**plain, **{name.encode(): value for name, value in changes.items()}}


@pytest.mark.parametrize(
    ("message", "says"),
    [
        ({"a": array(dtype="|O")}, r"message.a: expected an array dtype out of .*got '\|O'"),
        ({"a": array(dtype="<U2")}, "expected an array dtype"),
        ({"a": array(dtype="<c8")}, "expected an array dtype"),
        ({"a": array(dtype="<f4,<f4")}, "expected an array dtype"),
        ({"a": array(shape=[3])}, r"expected 12 bytes for an array \[3\] of <f4, got 8 bytes"),
        ({"a": array(shape=[-2])}, "expected a shape of at most"),
        ({"a": array(shape=[1 << 40])}, "expected a shape of at most"),
        ({"a": array(shape=[1] * 5)}, "expected a shape of at most 4 sizes"),
        ({"a": array(data="text")}, "expected 8 bytes .* got str"),
        ({"a": array(more=1)}, "with the keys"),
        ({"a": array(__ndarray__=1)}, "with the keys"),
        ({"a": {b"__npgeneric__": True, b"data": [1], b"dtype": "<f4"}}, "expected a number of one of"),
        ({"a": {b"__npgeneric__": True, b"data": 1, b"dtype": "|O"}}, "expected a number of one of"),
        ({"a": {b"__npgeneric__": True, b"data": 300, b"dtype": "|u1"}}, r"expected a number of \|u1, got 300"),
        ({b"actions": 1}, "expected text as keys outside arrays, got b'actions'"),
        ({"__ndarray__": True, "data": b"", "dtype": "<f4", "shape": [0]}, "got text; pack with openpi_client.msgpack"),
        ({1: 2}, "expected msgpack, got"),
    ],
)
def test_what_is_not_openpis_is_refused(message: object, says: str) -> None:
    with pytest.raises(ContractError, match=says):
        unpack(msgpack.packb(message))


def test_depth_repeats_and_sizes_are_bounded() -> None:
    with pytest.raises(ContractError, match="expected at most 8 levels"):
        unpack(b"\x91" * 10 + b"\xc0")
    with pytest.raises(ContractError, match="each key of a map once"):
        unpack(b"\x82\xa1a\x01\xa1a\x02")
    with pytest.raises(ContractError, match=f"at most {MAX_REPLY_BYTES} bytes"):
        unpack(bytes(MAX_REPLY_BYTES + 1))


def test_a_length_that_is_claimed_allocates_nothing() -> None:
    tracemalloc.start()
    for claim in (b"\xc6\x7f\xff\xff\xff", b"\xdd\x7f\xff\xff\xff", b"\xdf\x7f\xff\xff\xff", b"\xdb\x7f\xff\xff\xff"):
        with pytest.raises(ContractError):
            unpack(claim + bytes(64))
    with pytest.raises(ContractError, match="expected a shape"):
        unpack(msgpack.packb({"a": array(shape=[1 << 25, 1 << 25])}))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < MAX_REPLY_BYTES


VALUES = strategies.recursive(
    strategies.none() | strategies.booleans() | strategies.integers(-(2**63), 2**64 - 1) | strategies.text(max_size=9)
    | arrays.arrays(
        strategies.sampled_from([np.dtype(dtype) for dtype in DTYPES]),
        arrays.array_shapes(min_dims=0, max_dims=4, min_side=0, max_side=4),
    ),
    lambda inner: strategies.lists(inner, max_size=3) | strategies.dictionaries(strategies.text(max_size=9), inner,
                                                                                max_size=3),
    max_leaves=6,
)  # fmt: skip


@given(VALUES)
def test_what_is_packed_comes_back(value: object) -> None:
    assert pack(unpack(pack(value))) == pack(value)


@given(strategies.binary(max_size=200))
def test_any_bytes_are_understood_or_refused_with_a_reason(data: bytes) -> None:
    with contextlib.suppress(ContractError):
        unpack(data)

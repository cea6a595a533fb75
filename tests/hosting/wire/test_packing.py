from __future__ import annotations

import tracemalloc

import msgpack
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from carecontact.errors import ContractError
from carecontact.hosting.wire.packing import DTYPES, MAX_ITEMS, MAX_REPLY_BYTES, MAX_VALUES, pack, unpack

plain = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(2**63), 2**63 - 1)
    | st.floats(allow_nan=False)
    | st.text(max_size=8)
    | st.sampled_from(DTYPES).flatmap(
        lambda d: hnp.arrays(np.dtype(d), hnp.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=3))
    ),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(st.text(max_size=5).filter(lambda k: k != "__ndarray__"), inner, max_size=3)
    ),
    max_leaves=8,
)


def _same(a: object, b: object) -> bool:
    if isinstance(a, np.ndarray):
        return isinstance(b, np.ndarray) and a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()
    if isinstance(a, dict):
        return isinstance(b, dict) and a.keys() == b.keys() and all(_same(a[k], b[k]) for k in a)
    if isinstance(a, list):
        return isinstance(b, list) and len(a) == len(b) and all(map(_same, a, b))
    return type(a) is type(b) and a == b


@given(plain)
@settings(max_examples=80, deadline=None)
def test_what_is_packed_is_unpacked(value: object) -> None:
    assert _same(value, unpack(pack(value)))


def test_nan_payloads_and_byte_order_survive() -> None:
    odd = np.array([0x7FC00001, 0xFFC12345], "<u4").view("<f4")
    assert unpack(pack(odd)).tobytes() == odd.tobytes()
    big = unpack(pack(np.array([1.5, -2.0], ">f8")))
    assert big.dtype == np.dtype("<f8")
    assert big.tolist() == [1.5, -2.0]


def test_strided_input_arrives_in_c_order_and_writable() -> None:
    out = unpack(pack(np.arange(6).reshape(2, 3).T[::-1]))
    assert out.tolist() == [[2, 5], [1, 4], [0, 3]]
    out[0, 0] = 7


def _array(**changes: object) -> bytes:
    entry = {"__ndarray__": True, "dtype": "<f4", "shape": [2], "data": b"\0" * 8} | changes
    return msgpack.packb({k: v for k, v in entry.items() if v != "absent"})


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (_array(dtype="|O"), "expected an array dtype out of |b1"),
        (_array(dtype="<U4"), "got '<U4'"),
        (_array(dtype=[["a", "<f4"]]), "expected an array dtype"),
        (_array(shape=[3]), "expected 12 bytes for an array .* got 8"),
        (_array(shape=[-2]), "shape"),
        (_array(shape=[2.0]), "shape"),
        (_array(shape=[True, 2]), "shape"),
        (_array(shape=[1] * 5), "at most 4 sizes"),
        (_array(shape=[1 << 20, 1 << 20], data=b""), "elements"),
        (_array(shape="2"), "shape"),
        (_array(data="text"), "got str"),
        (_array(data="absent"), "expected an array with keys"),
        (_array(__ndarray__=1), "expected an array with keys"),
        (_array(pickle=b"x"), "expected an array with keys"),
        (_array(dtype="|b1", data=b"\x00\x02"), "expected 0 or 1 in a bool array, got the byte 2"),
        (b"", "not"),
        (b"\xc1", "not"),
        (pack([1]) + b"\x00", "not"),
        (b"\x82\xa1a\x01\xa1a\x02", "expected each key of a map once, got 'a' again"),
        (b"\x81\xc4\x01a\x01", "text as map keys, got b'a'"),
        (b"\x81\x01\x01", "not"),
        (b"\xc7\x01\x05x", "not"),
        (b"\xd6\xff\x00\x00\x00\x00", "not"),
        (b"\xdd\xff\xff\xff\xff", "not"),
        (b"\x91" * 20 + b"\xc0", "expected at most 8 levels"),
        (b"\x91" * 5000 + b"\xc0", "not"),
        (msgpack.packb([0] * (MAX_ITEMS + 1)), "not"),
        (msgpack.packb("x" * 70000), "not"),
        (b"\xa1\xff", "not"),
    ],
)
def test_hostile_bytes_are_refused(data: bytes, says: str) -> None:
    with pytest.raises(ContractError, match="(?s)" + says.replace("|", r"\|")):
        unpack(data)


@pytest.mark.parametrize("value", [b"\xc0", b"\x90", b"\x80", b"\x81\xa1a\x01"])
def test_many_small_values_are_refused_before_they_fill_memory(value: bytes) -> None:
    data = b"\xdc\x04\x00" + 1024 * (b"\xdc\x03\xe8" + 1000 * value)
    tracemalloc.start()
    try:
        with pytest.raises(ContractError, match=f"at most {MAX_VALUES} lists, maps"):
            unpack(data)
        assert tracemalloc.get_traced_memory()[1] < 64 << 20
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("data", [bytes(1 << 20), pack({"k" * 60_000: {"__ndarray__": True}})])
def test_a_refusal_does_not_repeat_the_message(data: bytes) -> None:
    with pytest.raises(ContractError) as caught:
        unpack(data)
    assert len(str(caught.value)) < 1000


def test_size_bound() -> None:
    with pytest.raises(ContractError, match="at most"):
        unpack(bytes(MAX_REPLY_BYTES + 1), max_bytes=MAX_REPLY_BYTES)


@pytest.mark.parametrize("value", [object(), {1, 2}, np.array(["a"]), np.array([None]), np.zeros(2, complex), 1 << 70])
def test_what_has_no_place_is_not_sent(value: object) -> None:
    with pytest.raises(ContractError, match="cannot be encoded"):
        pack({"value": value})

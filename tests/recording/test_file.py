from __future__ import annotations

import errno
import fcntl
import re
import tempfile
import zlib
from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from carecontact.errors import RecordingError
from carecontact.recording import (
    ARRAYS,
    OPTIONAL_ARRAYS,
    Recording,
    canonical_hash,
    file,
    open_recording,
    read_recording,
    schema,
    write_recording,
)
from carecontact.recording.file import read_header
from carecontact.recording.schema import MAX_WALL_BYTES, dimensions
from carecontact.scoring import score_recording
from tests.scoring.synthetic import before_start, make_recording, touch

EXTRA = {"wall/act_s": np.linspace(0, 1, 400), "policy/frames/0/overhead/rgb": np.full((8, 8, 3), 7, np.uint8)}


@pytest.fixture(scope="module")
def image(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    path = write_recording(make_recording(duration=0.3, extra=EXTRA), tmp_path_factory.mktemp("image") / "T1-s000.h5")
    return path.read_bytes()


def rewrite(path: Path, image: bytes, name: str, data: object) -> Path:
    path.write_bytes(image)
    with h5py.File(path, "r+") as file:
        del file[name]
        if data is not None:
            file.create_dataset(name, data=data)
    return path


def without(recording: Recording, path: str) -> Recording:
    return Recording(header=recording.header, arrays={k: v for k, v in recording.arrays.items() if k != path})


def replaced(recording: Recording, path: str, array: np.ndarray) -> Recording:
    return Recording(header=recording.header, arrays={**recording.arrays, path: array})


@pytest.mark.parametrize("recording", [touch(), before_start()], ids=["full", "before start"])
def test_round_trip(tmp_path: Path, recording: Recording) -> None:
    path = write_recording(recording, tmp_path / "T1-s000.h5")
    back = read_recording(path)
    assert back.header == recording.header
    assert back.arrays.keys() == recording.arrays.keys()
    for name, array in recording.arrays.items():
        assert back[name].dtype == array.dtype, name
        np.testing.assert_array_equal(back[name], array, err_msg=name)
    assert canonical_hash(back) == canonical_hash(recording)
    assert [p.name for p in tmp_path.iterdir()] == ["T1-s000.h5"], "a temporary file was left behind"


def test_same_recording_same_bytes(tmp_path: Path) -> None:
    first, second = (write_recording(touch(), tmp_path / d / "T1-s000.h5") for d in _folders(tmp_path))
    assert first.read_bytes() == second.read_bytes()


def _folders(tmp_path: Path) -> list[str]:
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
    return ["a", "b"]


def test_failed_write_keeps_the_old_file(tmp_path: Path) -> None:
    path = write_recording(touch(), tmp_path / "T1-s000.h5")
    before = path.read_bytes()
    with pytest.raises(RecordingError, match="scorer/time_s"):
        write_recording(without(touch(), "scorer/time_s"), path)
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_hash_ignores_wall_clock_and_byte_order_only() -> None:
    plain = touch()
    assert canonical_hash(replaced(plain, "wall/act_s", np.ones(3))) == canonical_hash(plain)
    big_endian = plain["scorer/time_s"].astype(">f8")
    assert canonical_hash(replaced(plain, "scorer/time_s", big_endian)) == canonical_hash(plain)
    changed = {
        "policy": touch(policy="other"),
        "value": touch(force=5.0001),
        "name": replaced(plain, "perception/x", np.ones(3)),
        "dtype": replaced(plain, "perception/x", np.ones(3, "f4")),
        "shape": replaced(plain, "state/integration", np.zeros((0, 3))),
    }
    hashes = {canonical_hash(r) for r in changed.values()}
    assert len(hashes) == len(changed)
    assert canonical_hash(plain) not in hashes


def test_a_recording_is_checked_when_made_and_hashed_when_written_and_when_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Who opens the file of a verified recording, scores it or asks for its hash does neither."""
    done: list[str] = []
    for module, name in ((schema, "check_recording"), (file, "check_recording"), (file, "canonical_digest")):
        real = getattr(module, name)
        monkeypatch.setattr(module, name, lambda *given, real=real, name=name: (done.append(name), real(*given))[1])
    made = Recording(header=touch().header, arrays=touch().arrays)
    done.clear()
    path = write_recording(made, tmp_path / "T1-s000.h5")
    score = score_recording(read_recording(path))
    assert open_recording(path, sha256=score.recording_sha256)["scorer/time_s"].size
    assert done == ["canonical_digest", "check_recording", "canonical_digest"]


def test_a_recording_is_read_only(tmp_path: Path) -> None:
    given = dict(touch().arrays)
    made = Recording(header=touch().header, arrays=given)
    given.clear()
    for recording in (made, read_recording(write_recording(made, tmp_path / "T1-s000.h5"))):
        assert recording.keys() == touch().keys()
        with pytest.raises(ValueError, match="read-only"):
            recording["scorer/normal_force"][0] = 1.0
        with pytest.raises(TypeError, match="does not support item assignment"):
            recording.arrays["scorer/normal_force"] = np.zeros(3)  # type: ignore[index]


@given(share=st.floats(0.0, 0.999))
@settings(max_examples=40, deadline=None)
def test_truncated(image: bytes, share: float) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "T1-s000.h5")
        path.write_bytes(image[: int(len(image) * share)])
        with pytest.raises(RecordingError, match=r"T1-s000\.h5"):
            read_recording(path)


@given(position=st.floats(0, 1, exclude_max=True), bit=st.integers(0, 7))
@settings(max_examples=150, deadline=None)
def test_bit_flip_is_named_or_harmless(image: bytes, position: float, bit: int) -> None:
    """Some bytes of an HDF5 file are padding; a flip there may pass, but only with the content unchanged."""
    damaged = bytearray(image)
    damaged[int(position * len(image))] ^= 1 << bit
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "T1-s000.h5")
        path.write_bytes(damaged)
        try:
            found = read_recording(path)
        except RecordingError as error:
            assert "T1-s000.h5" in str(error)  # noqa: PT017
        else:
            assert canonical_hash(found) == canonical_hash(make_recording(duration=0.3, extra=EXTRA))


def test_damage_inside_an_array_is_an_error(tmp_path: Path, image: bytes) -> None:
    path = tmp_path / "T1-s000.h5"
    path.write_bytes(image)
    with h5py.File(path) as file:
        chunk = file["scorer/force_human_from_robot_in_world"].id.get_chunk_info(0)
    damaged = bytearray(image)
    damaged[chunk.byte_offset + chunk.size // 2] ^= 1
    path.write_bytes(damaged)
    with pytest.raises(RecordingError, match="damaged"):
        read_recording(path)


def test_checksum_catches_an_edit_that_hdf5_accepts(tmp_path: Path, image: bytes) -> None:
    path = rewrite(tmp_path / "T1-s000.h5", image, "scorer/wrist_settled_in_world", np.zeros(3))
    with pytest.raises(RecordingError, match="checksum"):
        read_recording(path)


@pytest.mark.parametrize("name", sorted(ARRAYS))
def test_missing_array(tmp_path: Path, image: bytes, name: str) -> None:
    with pytest.raises(RecordingError, match=name):
        read_recording(rewrite(tmp_path / "T1-s000.h5", image, name, None))


@pytest.mark.parametrize(
    ("name", "data", "words"),
    [
        ("scorer/tcp_speed", np.zeros(150), r"dtype float64, expected float32"),
        ("scorer/tcp_speed", np.zeros(7, np.float32), r"T = 150|T = 7"),
        ("scorer/normal_force", np.zeros(150, np.float32), r"expected \(T, S\)"),
        ("scorer/region_size_m", np.zeros((3, 4)), r"with 3 = 3 as in the schema"),
        ("scorer/human_joint_settled", np.zeros(5), r"J = 2 as in header.human_joints"),
        ("wall/act_s", [b"text"], r"only numbers"),
        ("header_json", np.frombuffer(b"{]", np.uint8), r"header_json is not JSON"),
        ("header_json", np.frombuffer(b'{"schema_version": "v9"}', np.uint8), r"schema 'v9'"),
        ("header_json", np.frombuffer(b"[1]", np.uint8), r"schema None"),
        ("sha256", None, r"sha256 missing"),
    ],
)
def test_wrong_content(tmp_path: Path, image: bytes, name: str, data: object, words: str) -> None:
    with pytest.raises(RecordingError, match=words):
        read_recording(rewrite(tmp_path / "T1-s000.h5", image, name, data))


def test_foreign_files(tmp_path: Path) -> None:
    path = tmp_path / "T1-s000.h5"
    with pytest.raises(RecordingError, match="no such file"):
        read_recording(path)
    for content in (b"", b"hello", b"\x89HDF\r\n\x1a\n" + bytes(200)):
        path.write_bytes(content)
        with pytest.raises(RecordingError, match="not a readable HDF5 file"):
            read_recording(path)
    with h5py.File(path, "w") as file:
        file["x"] = [1.0]
    with pytest.raises(RecordingError, match="not a carecontact recording"):
        read_recording(path)


def test_claimed_size_is_refused_before_unpacking(tmp_path: Path, image: bytes) -> None:
    path = tmp_path / "T1-s000.h5"
    path.write_bytes(image)
    with h5py.File(path, "r+") as file:
        file.create_dataset("perception/bomb", shape=(1 << 40,), dtype="f8", chunks=(1 << 16,), compression="gzip")
    with pytest.raises(RecordingError, match="perception/bomb declares"):
        read_recording(path)


def test_a_few_megabytes_that_unpack_to_gigabytes_are_refused(tmp_path: Path, image: bytes) -> None:
    path, chunk = tmp_path / "T1-s000.h5", 8 << 20
    packed = zlib.compress(bytes(chunk), 9)
    path.write_bytes(image)
    with h5py.File(path, "r+") as file:
        bomb = file.create_dataset("perception/bomb", (256 * chunk,), "u1", chunks=(chunk,), compression="gzip")
        for number in range(256):
            bomb.id.write_direct_chunk((number * chunk,), packed)
    assert path.stat().st_size < 3_000_000
    with pytest.raises(RecordingError, match="perception/bomb declares 2147483648 bytes, more than a trial may have"):
        read_recording(path)


def test_what_no_checksum_covers_is_small(tmp_path: Path, image: bytes) -> None:
    path = tmp_path / "T1-s000.h5"
    large = np.random.default_rng(0).integers(0, 256, MAX_WALL_BYTES + 1, np.uint8)
    message = (
        f"wall/ has {large.size + 3200} bytes, which no checksum covers; at most {MAX_WALL_BYTES} are allowed there"
    )
    path.write_bytes(image)
    with h5py.File(path, "r+") as file:
        file["wall/hidden"] = large
    with pytest.raises(RecordingError, match=message):
        read_recording(path)
    with pytest.raises(RecordingError, match="which no checksum covers"):
        write_recording(make_recording(extra={"wall/hidden": large}), path)


def test_little_can_hide_beside_the_arrays(tmp_path: Path, image: bytes) -> None:
    path = tmp_path / "T1-s000.h5"
    path.write_bytes(image + bytes(1 << 19))
    read_recording(path)
    path.write_bytes(image + bytes(20 << 20))
    with pytest.raises(RecordingError, match="bytes beside the arrays"):
        read_recording(path)
    path.write_bytes(image)
    with h5py.File(path, "r+") as file:
        for n in range(40):
            file.attrs[f"note {n}"] = "x" * 60_000
    with pytest.raises(RecordingError, match="bytes beside the arrays"):
        read_recording(path)


def test_links_are_refused(tmp_path: Path, image: bytes) -> None:
    path = tmp_path / "T1-s000.h5"
    path.write_bytes(image)
    with h5py.File(path, "r+") as file:
        file["perception"] = h5py.ExternalLink("other.h5", "/x")
    with pytest.raises(RecordingError, match="perception is a link"):
        read_recording(path)


@pytest.mark.parametrize("path", ["loose", "other/x", "scorer/../x", "/scorer/x", "scorer/"])
def test_paths_outside_the_schema_are_refused(tmp_path: Path, path: str) -> None:
    with pytest.raises(RecordingError, match="unexpected array path"):
        write_recording(make_recording(extra={path: np.zeros(1)}), tmp_path / "T1-s000.h5")


def shaped(path: str, recording: Recording, *, more: int = 0) -> np.ndarray:
    """Zeros that fit the schema and the recording; ``more``: so much longer along the first dimension."""
    sizes = {"C": 5, "E": 2, "L": 3, "V": 4, "Q": 7}
    for required in ARRAYS:
        sizes |= dict(zip(dimensions(required), recording[required].shape, strict=True))
    shape = [int(name) if name.isdecimal() else sizes[name] for name in dimensions(path)]
    return np.zeros([shape[0] + more, *shape[1:]], OPTIONAL_ARRAYS[path][0])


PARTNERS = {
    **{path: "perception/camera_index" for path in OPTIONAL_ARRAYS if path.startswith("perception/")},
    "perception/camera_index": "perception/human_iou",
    "scorer/cell_area_m2": "scorer/cell_press_ns",
    "scorer/cell_in_region": "scorer/cell_press_ns",
    "scorer/foam_cell_share": "scorer/cell_press_ns",
    "scorer/repositioning_s": "scorer/repositioning_rad",
    "scorer/repositioning_rad": "scorer/repositioning_s",
}
"""Optional array -> another one of the same length."""


@pytest.mark.parametrize("path", sorted(OPTIONAL_ARRAYS))
def test_an_optional_array_is_stored_and_has_to_fit(tmp_path: Path, path: str) -> None:
    plain = make_recording()
    stored = Recording(header=plain.header, arrays=plain.arrays | {path: shaped(path, plain)})
    kept = read_recording(write_recording(stored, tmp_path / "T1-s000.h5"))
    assert kept[path].shape == stored[path].shape
    assert canonical_hash(stored) != canonical_hash(plain)
    # Their first dimension is in no required array.
    beside = PARTNERS.get(path)
    others = {beside: shaped(beside, plain)} if beside else {}
    with pytest.raises(RecordingError, match=f"{path}|{beside}" if beside else path):
        Recording(header=plain.header, arrays=plain.arrays | others | {path: shaped(path, plain, more=1)})


def test_a_recording_that_another_process_has_locked_is_read(tmp_path: Path) -> None:
    """Nor does a file system need to have locks."""
    path = write_recording(touch(), tmp_path / "a.h5")
    with path.open("rb+") as other:
        fcntl.flock(other, fcntl.LOCK_EX)
        assert read_recording(path).header == touch().header


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (OSError(errno.EIO, "Can't read data (file read failed)"), "Input/output error"),
        (OSError(errno.ESTALE, "Unable to open file"), "Stale file handle"),
        (PermissionError(errno.EACCES, "Unable to open file"), "Permission denied"),
        (
            OSError(errno.ENOLCK, "Unable to open file (unable to lock file, errno = 37)"),
            "No locks available; HDF5_USE_FILE_LOCKING=TRUE demands locks that its file system lacks: unset it",
        ),
    ],
    ids=lambda value: errno.errorcode[value.errno] if isinstance(value, OSError) else "",
)
def test_a_fault_of_the_machine_is_no_damage(
    error: OSError, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(*_: object, **options: object) -> None:
        raise error

    path = write_recording(touch(), tmp_path / "a.h5")
    monkeypatch.setenv("HDF5_USE_FILE_LOCKING", "TRUE")
    monkeypatch.setattr(h5py, "File", refused)
    for read in (read_recording, read_header):
        with pytest.raises(OSError, match=re.escape(message)) as raised:
            read(path)
        assert (raised.value.errno, raised.value.filename, raised.value.strerror) == (error.errno, str(path), message)

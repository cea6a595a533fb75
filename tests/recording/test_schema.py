"""The header of a trial file, read without its arrays."""

from __future__ import annotations

import hashlib
import json
import platform
import re
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from carecontact import __version__
from carecontact.errors import RecordingError
from carecontact.recording import (
    SCHEMA_VERSION,
    Recording,
    canonical_hash,
    open_recording,
    read_header,
    read_recording,
    stored_sha256,
    write_recording,
)
from carecontact.recording.file import header_json
from carecontact.recording.provenance import arithmetic, package_versions
from carecontact.recording.schema import RELEASE_0_1_0
from tests.recording.raw_file import store
from tests.scoring.synthetic import before_start, touch


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return write_recording(touch(), tmp_path / "T1-s000.h5")


def flip(path: Path, dataset: str) -> None:
    """A bit in the middle of a dataset's first chunk."""
    with h5py.File(path) as content:
        chunk = content[dataset].id.get_chunk_info(0)
    damaged = bytearray(path.read_bytes())
    damaged[chunk.byte_offset + chunk.size // 2] ^= 1
    path.write_bytes(damaged)


@pytest.mark.parametrize("recording", [touch(), before_start()], ids=["full", "before start"])
def test_header_and_checksum_are_those_of_the_whole_recording(tmp_path: Path, recording: Recording) -> None:
    path = write_recording(recording, tmp_path / "T1-s000.h5")
    assert read_header(path) == read_recording(path).header == recording.header
    assert stored_sha256(path) == canonical_hash(recording)


@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.9, 0.999])
def test_a_truncated_file_is_found(file: Path, share: float) -> None:
    content = file.read_bytes()
    file.write_bytes(content[: int(share * len(content))])
    for read in (read_header, stored_sha256):
        with pytest.raises(RecordingError, match=r"T1-s000\.h5: not a readable HDF5 file"):
            read(file)


def test_damage_to_header_or_checksum_is_found(file: Path) -> None:
    whole = file.read_bytes()
    flip(file, "header_json")
    with pytest.raises(RecordingError, match="header_json is truncated or damaged"):
        read_header(file)
    file.write_bytes(whole)
    flip(file, "sha256")
    for read in (read_header, stored_sha256):
        with pytest.raises(RecordingError, match="sha256 is truncated or damaged"):
            read(file)


def test_damage_to_an_array_is_left_to_those_who_read_it(file: Path) -> None:
    flip(file, "scorer/force_human_from_robot_in_world")
    assert read_header(file) == touch().header
    with pytest.raises(RecordingError, match="damaged"):
        read_recording(file)


@pytest.mark.parametrize(
    ("name", "data", "words"),
    [
        ("header_json", np.frombuffer(b"{]", np.uint8), "header_json is not JSON"),
        ("header_json", np.frombuffer(b'{"schema_version": "v9"}', np.uint8), "schema 'v9'"),
        ("header_json", np.zeros(3), "expected a row of bytes"),
        ("header_json", None, "header_json missing"),
        ("sha256", None, "sha256 missing"),
    ],
)
def test_wrong_content(file: Path, name: str, data: object, words: str) -> None:
    with h5py.File(file, "r+") as content:
        del content[name]
        if data is not None:
            content.create_dataset(name, data=data)
    with pytest.raises(RecordingError, match=words):
        read_header(file)


def test_a_header_that_no_trial_can_have(tmp_path: Path) -> None:
    header = json.loads(header_json(touch().header))
    header["spec"]["task_id"] = "T99"
    with pytest.raises(RecordingError, match="task 'T99' is not in protocol"):
        read_header(store(tmp_path / "T1-s000.h5", header, {}))


def test_a_header_in_another_file_or_of_claimed_size_is_refused(tmp_path: Path, file: Path) -> None:
    with h5py.File(file, "r+") as content:
        del content["header_json"]
        content["header_json"] = h5py.ExternalLink("other.h5", "/header_json")
    with pytest.raises(RecordingError, match="header_json missing"):
        read_header(file)
    with h5py.File(file, "r+") as content:
        del content["header_json"]
        content.create_dataset("header_json", shape=(1 << 40,), dtype="u1", chunks=(1 << 16,), compression="gzip")
    with pytest.raises(RecordingError, match="header_json declares"):
        read_header(file)


def test_an_absent_and_a_foreign_file(tmp_path: Path) -> None:
    path = tmp_path / "T1-s000.h5"
    with pytest.raises(RecordingError, match="no such file"):
        read_header(path)
    with h5py.File(path, "w") as content:
        content["x"] = [1.0]
    with pytest.raises(RecordingError, match="not a carecontact recording"):
        read_header(path)


def test_an_opened_recording_reads_an_array_when_it_is_used(file: Path) -> None:
    flip(file, "scorer/force_human_from_robot_in_world")
    recording = open_recording(file, sha256=canonical_hash(touch()))
    file.unlink()  # The supervisor moves a file that is open.
    assert recording.header == touch().header
    assert recording.keys() == touch().keys()
    np.testing.assert_array_equal(recording["scorer/normal_force"], touch()["scorer/normal_force"])
    with pytest.raises(RecordingError, match="force_human_from_robot_in_world is truncated or damaged"):
        recording["scorer/force_human_from_robot_in_world"]


def test_only_the_recording_that_was_verified_is_opened(file: Path) -> None:
    with pytest.raises(RecordingError, match=r"T1-s000\.h5: sha256 [0-9a-f]{12} and not 000000000000, as when"):
        open_recording(file, sha256="0" * 64)


@pytest.mark.parametrize("number", [1, 2, 3])
def test_a_recording_of_release_0_1_0_names_the_release_that_reads_it(tmp_path: Path, number: int) -> None:
    header = json.loads(header_json(touch().header)) | {"schema_version": f"carecontact-recording-{number}"}
    path = store(tmp_path / "T1-s000.h5", header, touch().arrays)
    for read in (read_recording, open_recording, read_header):
        with pytest.raises(RecordingError, match=r"T1-s000\.h5: .* 0\.1\.0 \(commit 663c7e23[0-9a-f]{32}\) reads it"):
            read(path)


def test_the_release_is_named_as_in_the_changes() -> None:
    changes = (Path(__file__).parents[2] / "CHANGELOG.md").read_text()
    release, commit = re.fullmatch(r"(\S+) \(commit (\w+)\)", RELEASE_0_1_0).groups()
    assert f"## {release}\n\nCommit `{commit}`" in changes


@pytest.mark.parametrize("version", [None, "3", "another-recording-4"])
def test_a_schema_of_no_release_is_no_recording(version: str | None, tmp_path: Path) -> None:
    header = json.loads(header_json(touch().header)) | {"schema_version": version}
    with pytest.raises(RecordingError, match="no recording of carecontact"):
        read_header(store(tmp_path / "T1-s000.h5", header, touch().arrays))


def test_a_newer_schema_is_named(tmp_path: Path) -> None:
    header = json.loads(header_json(touch().header)) | {"schema_version": "carecontact-recording-5"}
    with pytest.raises(RecordingError, match=f"written by a newer release; this one reads '{SCHEMA_VERSION}'"):
        read_header(store(tmp_path / "T1-s000.h5", header, touch().arrays))


def test_the_bytes_of_a_header_are_pinned() -> None:
    """Every hash of a recording covers them. A field that changes them on purpose changes this test."""
    header = touch().header
    spelled = json.loads(header_json(header))
    assert sorted(spelled) == [
        "card", "comfort_arm_deg", "control", "drawn", "embodiment", "ended", "failure", "human_joints", "identity",
        "pose_base_in_world", "privileged", "regions", "schema_version", "segments", "sha256", "solver_warnings",
        "spec", "versions",
    ]  # fmt: skip
    spelled["spec"] = spelled["versions"] = None  # the protocol and the packages have tests of their own
    digest = hashlib.sha256(json.dumps(spelled, sort_keys=True, separators=(",", ":")).encode()).hexdigest()
    assert digest == "41bcf36d203c81c62e18a3dd7dc71e438eb2fef5d870b4e6e255ebf7dace83fa"


def row(api: str, package: str, **facts: str) -> dict[str, Any]:
    return {"user_api": api, "internal_api": "openblas", "filepath": f"/site/{package}.libs/lib.so", **facts}


def loaded(monkeypatch: pytest.MonkeyPatch, *rows: dict[str, Any]) -> str:
    monkeypatch.setattr("threadpoolctl.threadpool_info", lambda: list(rows))
    return arithmetic().split(" on ")[0]


def test_it_names_the_processors_family_linear_algebra_and_the_c_library() -> None:
    assert np.ones(2) @ np.ones(2) == 2.0  # numpy's library is loaded
    algebra, rest = arithmetic().split(" on ")
    assert algebra == "unknown linear algebra" or len(algebra.split(" ")) == 3
    assert rest == f"{platform.machine()} with {' '.join(platform.libc_ver()).strip() or 'an unknown C library'}"


def test_numpys_library_counts_among_several(monkeypatch: pytest.MonkeyPatch) -> None:
    omp = row("openmp", "numpy", version="5")
    scipy = row("blas", "scipy", version="0.3.30", architecture="Zen")
    numpy = row("blas", "numpy", version="0.3.31", architecture="SkylakeX")
    assert loaded(monkeypatch, omp, scipy, numpy) == "openblas 0.3.31 SkylakeX"
    assert loaded(monkeypatch, omp, scipy) == "openblas 0.3.30 Zen"


def test_what_is_not_known_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    assert loaded(monkeypatch) == "unknown linear algebra"
    assert loaded(monkeypatch, row("blas", "numpy", version="3")) == "openblas 3"
    monkeypatch.setattr("platform.libc_ver", lambda: ("", ""))
    assert arithmetic().endswith(" with an unknown C library")


# Which packages a recording names.


def test_versions_name_the_package_that_runs() -> None:
    assert package_versions()["carecontact"] == __version__

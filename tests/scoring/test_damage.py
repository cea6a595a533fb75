"""Two hundred damaged, foreign and lying files: each is named with its fault, or is the same data still."""

from __future__ import annotations

import copy
import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

import carecontact
from carecontact.recording import ARRAYS, Recording, canonical_hash, write_recording
from carecontact.recording.file import header_json
from carecontact.scoring import TrialScore, score_recording
from tests.recording.raw_file import store
from tests.scoring.synthetic import before_start, hold, make_recording, push

Arrays = dict[str, np.ndarray]
MUTANTS = 200
MEMORY_BYTES = 4 << 30
"""Address space of the process that reads them, interpreter and libraries included."""
BESIDE_EVERY = 4
"""Folder in so many that has a good recording beside the damaged one; one process reads them all."""
TARGETS = [(0.1, (0.0, 0.0, 0.04)), (0.4, (0.05, 0.0, 0.04))]

GOOD = {
    "touch": make_recording("T1", duration=0.7, normal={"right_forearm": hold(0.7, 0.1, 0.7, 5.0)}),
    "missed": make_recording("T1", duration=0.2, targets_in_region=TARGETS),
    "died": before_start(),
}
BESIDE = make_recording("T2", duration=0.3, normal={"right_forearm": hold(0.3, 0.1, 0.3, 5.0)})


# Files whose bytes are damaged: what was written is in there still, or was.


def flipped(image: bytes, rng: np.random.Generator) -> bytes:
    out = bytearray(image)
    out[rng.integers(len(image))] ^= 1 << rng.integers(8)
    return bytes(out)


def torn(image: bytes, rng: np.random.Generator) -> bytes:
    start = int(rng.integers(len(image)))
    return image[:start] + bytes(min(64, len(image) - start)) + image[start + 64 :]


def truncated(image: bytes, rng: np.random.Generator) -> bytes:
    return image[: rng.integers(len(image))]


def lengthened(image: bytes, rng: np.random.Generator) -> bytes:
    return image + rng.bytes(100)


# Files that lie: another program wrote them, and their checksum holds.


def header_of(recording: Recording) -> dict[str, Any]:
    return json.loads(header_json(recording.header))


def put(*keys: str, value: object) -> Callable[[dict[str, Any]], None]:
    def change(header: dict[str, Any]) -> None:
        for key in keys[:-1]:
            header = header[key]
        header[keys[-1]] = value

    return change


HEADERS: dict[str, Callable[[dict[str, Any]], object]] = {
    "schema of the future": put("schema_version", value="carecontact-recording-5"),
    "schema is a list": put("schema_version", value=["carecontact-recording-4"]),
    "no schema": lambda h: h.pop("schema_version"),
    "no spec": lambda h: h.pop("spec"),
    "more than there should be": put("more", value=1),
    "unknown task": put("spec", "task_id", value="T9"),
    "unknown end": put("ended", value="never"),
    "no regions": put("regions", value=[]),
    "other regions": put("regions", value=["leg", "arm", "belly"]),
    "a segment twice": lambda h: h["segments"].__setitem__(1, h["segments"][0]),
    "target segment absent": lambda h: h["segments"].__setitem__(h["segments"].index("right_forearm"), "tail"),
    "one segment more": lambda h: h["segments"].append("tail"),
    "a joint less": lambda h: h["human_joints"].pop(),
    "base nowhere": put("pose_base_in_world", value=[float("nan")] * 7),
    "base short": put("pose_base_in_world", value=[0.0] * 6),
    "no gates": lambda h: h["spec"]["protocol"].pop("gates"),
    "a pain limit of zero": put("spec", "protocol", "limits", "f_pain_n", value={"forearm": 0.0}),
    "physics too coarse for the filter": put("spec", "protocol", "physics", "dt_s", value=0.02),
    "a filter above half the rate": put("spec", "protocol", "contact", "filter_hz", value=300.0),
    "seed in words": put("spec", "seed", value="zero"),
}


def without(path: str) -> Callable[[Arrays], None]:
    return lambda arrays: [arrays.pop(name) for name in list(arrays) if name == path or name.startswith(f"{path}/")]


def holding(path: str, value: float) -> Callable[[Arrays], None]:
    def change(arrays: Arrays) -> None:
        broken = arrays[path].copy()
        broken[(0,) * broken.ndim] = value
        arrays[path] = broken

    return change


def typed(path: str, dtype: str) -> Callable[[Arrays], None]:
    return lambda arrays: arrays.__setitem__(path, arrays[path].astype(dtype))


def shaped(path: str, change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Arrays], None]:
    return lambda arrays: arrays.__setitem__(path, change(arrays[path]))


STREAMS = [p for p, (dtype, _) in ARRAYS.items() if p.startswith("scorer/") and dtype.startswith("f")]
CONTENTS: dict[str, Callable[[Arrays], object]] = {
    **{f"no {path}": without(path) for path in (*list(ARRAYS)[::2], "scorer", "actions", "policy", "state")},
    **{f"NaN in {path}": holding(path, float("nan")) for path in STREAMS[::2]},
    **{f"infinity in {path}": holding(path, float("inf")) for path in STREAMS[1::2]},
    "NaN in actions/time_s": holding("actions/time_s", float("nan")),
    "a force below zero": holding("scorer/normal_force", -1.0),
    "a region without size": holding("scorer/region_size_m", 0.0),
    "no rotation": shaped("scorer/region_pose_in_world", lambda a: a * np.float32(1.01)),
    "no rotation of the tool": lambda a: a.__setitem__("scorer/pose_tcp_in_world", a["scorer/pose_tcp_in_world"] * 2),
    "time stands": lambda a: a.__setitem__("scorer/time_s", a["scorer/time_s"] * 0),
    "time runs back": lambda a: a.__setitem__("scorer/time_s", a["scorer/time_s"][::-1].copy()),
    "too wide a type": typed("scorer/tcp_speed", "f8"),
    "too narrow a type": typed("scorer/time_s", "f4"),
    "whole numbers": typed("scorer/normal_force", "i4"),
    "unsigned numbers": typed("actions/observation_index", "u4"),
    "complex numbers": typed("scorer/wrist_in_world", "c8"),
    "half a row": shaped("scorer/tcp_speed", lambda a: a[: len(a) // 2]),
    "a column less": shaped("scorer/normal_force", lambda a: a[:, 1:]),
    "an axis more": shaped("scorer/tcp_speed", lambda a: a[:, None]),
    "an array at the root": lambda a: a.__setitem__("loose", np.zeros(3)),
    "a group that is none of ours": lambda a: a.__setitem__("other/x", np.zeros(3)),
    "a group called like no folder": lambda a: a.__setitem__("scorer/../x", np.zeros(3)),
}


# Files that HDF5 itself can hold and a recording cannot.


def claim(name: str, shape: tuple[int, ...], **options: Any) -> Callable[[Path], None]:
    def change(path: Path) -> None:
        with h5py.File(path, "r+") as file:
            if name in file:
                del file[name]
            file.create_dataset(name, shape=shape, dtype="f4", **options)

    return change


def in_file(change: Callable[[h5py.File], object]) -> Callable[[Path], None]:
    def apply(path: Path) -> None:
        with h5py.File(path, "r+") as file:
            change(file)

    return apply


def replace_by(content: bytes) -> Callable[[Path], None]:
    return lambda path: path.write_bytes(content) and None


def other_hdf5(path: Path) -> None:
    with h5py.File(path, "w") as file:
        file["weights/layer0"] = np.ones((4, 4))


def a_folder(path: Path) -> None:
    path.unlink()
    path.mkdir()


def only_zeros(file: h5py.File) -> None:
    """3 GB of zeros that deflate has really packed would be allowed by ratio alone; a few hundred bytes are not."""
    file.create_dataset("perception/zeros", shape=(3 << 28,), dtype="f4", chunks=(1 << 24,), compression="gzip")


FILES: dict[str, Callable[[Path], None]] = {
    "terabytes never written": claim("perception/x", (1 << 40,), chunks=(1 << 16,), compression="gzip"),
    "gigabytes never written": claim("perception/x", (3 << 28,), chunks=(1 << 16,)),
    "gigabytes of contiguous nothing": claim("perception/x", (3 << 28,)),
    "a long trial never written": claim(
        "scorer/force_human_from_robot_in_world", (1 << 24, 17, 3), chunks=(512, 17, 3)
    ),
    "a dimension near the end of counting": claim("perception/x", (1 << 62,), chunks=(1 << 10,)),
    "a chunk larger than memory": claim("perception/x", (1 << 29,), chunks=(1 << 29,), compression="gzip"),
    "zeros": in_file(only_zeros),
    "text in an array": in_file(lambda f: f.__setitem__("perception/x", "words")),
    "a compound type": in_file(lambda f: f.__setitem__("perception/x", np.zeros(3, "i4,f8"))),
    "references": in_file(lambda f: f.create_dataset("perception/x", (3,), h5py.ref_dtype)),
    "no data at all": in_file(lambda f: f.create_dataset("perception/x", data=h5py.Empty("f4"))),
    "a link out of the file": in_file(lambda f: f.__setitem__("perception", h5py.ExternalLink("/etc/passwd", "/x"))),
    "a link in a circle": in_file(lambda f: f["scorer"].__setitem__("again", f["/"])),
    "a soft link": in_file(lambda f: f.__setitem__("perception", h5py.SoftLink("/scorer"))),
    "a named type": in_file(lambda f: f.__setitem__("perception", np.dtype("f8"))),
    "a name in another script": in_file(lambda f: f.__setitem__("perception/\u00e9\u202e", np.zeros(2))),
    "a name that is no text": in_file(lambda f: h5py.h5g.create(f.id, b"\xff\xfe")),
    "header of floats": in_file(lambda f: (f.pop("header_json"), f.__setitem__("header_json", np.ones(9)))),
    "checksum of another length": in_file(lambda f: (f.pop("sha256"), f.__setitem__("sha256", np.zeros(3, "u1")))),
    "no checksum": in_file(lambda f: f.pop("sha256")),
    "empty": replace_by(b""),
    "text": replace_by(b"time,force\n0.0,1.0\n"),
    "zeros only": replace_by(bytes(4096)),
    "a signature and nothing": replace_by(b"\x89HDF\r\n\x1a\n"),
    "other HDF5": other_hdf5,
    "a folder": a_folder,
}
HARMLESS: dict[str, Callable[[Path], None]] = {
    "an empty group": in_file(lambda f: f.create_group("perception")),
    "attributes": in_file(lambda f: f["scorer/time_s"].attrs.update(unit="s")),
    "wall-clock data": in_file(lambda f: f.__setitem__("wall/x", np.ones(3))),
}


def mutants(root: Path) -> Iterator[tuple[str, str, Callable[[Path], object], bool]]:
    """Name, which good recording it comes from, how to make it in place, and whether it may still be the same data."""
    rng = np.random.default_rng(20260101)
    images = {name: write_recording(r, root / f"{name}.h5").read_bytes() for name, r in GOOD.items()}

    def damaged(how: Callable[[bytes, np.random.Generator], bytes], base: str) -> Callable[[Path], object]:
        content = how(images[base], rng)
        return lambda path: path.write_bytes(content)

    def lying(base: str, header: dict[str, Any] | bytes, arrays: Arrays) -> Callable[[Path], object]:
        return lambda path: store(path, header, arrays)

    def from_good(base: str, change: Callable[[Path], None]) -> Callable[[Path], object]:
        def make(path: Path) -> None:
            path.write_bytes(images[base])
            change(path)

        return make

    for name, change in HEADERS.items():
        header = copy.deepcopy(header_of(GOOD["touch"]))
        change(header)
        yield f"header, {name}", "touch", lying("touch", header, GOOD["touch"].arrays), False
    for name, content in {
        "no JSON": b"{]",
        "too deep": b"[" * 200_000,
        "no text": b"\xff\xfe",
        "a list": b"[]",
    }.items():
        yield f"header, {name}", "touch", lying("touch", content, GOOD["touch"].arrays), False
    for name, change in CONTENTS.items():
        base = "missed" if name == "NaN in actions/time_s" else "touch"
        arrays = dict(GOOD[base].arrays)
        change(arrays)
        yield f"content, {name}", base, lying(base, header_of(GOOD[base]), arrays), False
    for name, change in FILES.items():
        yield f"file, {name}", "touch", from_good("touch", change), False
    for name, change in HARMLESS.items():
        yield f"harmless, {name}", "touch", from_good("touch", change), True
    kinds = [flipped] * 5 + [truncated, torn, lengthened]
    number = 0
    while True:
        base, kind = list(GOOD)[number % len(GOOD)], kinds[number % len(kinds)]
        yield f"{kind.__name__} {number:03d} of {base}", base, damaged(kind, base), kind is not truncated
        number += 1


CHILD = """
import json, pathlib, resource, sys, traceback
resource.setrlimit(resource.RLIMIT_AS, (int(sys.argv[2]),) * 2)
from carecontact.runs import score_run
out = {}
for folder in sorted(pathlib.Path(sys.argv[1]).iterdir()):
    print(folder.name, file=sys.stderr, flush=True)
    try:
        run = score_run(folder)
        scores = {s.trial_id: s.model_dump_json() for s in run.scores}
        found = {"skipped": run.skipped, "scores": scores}
    except BaseException:
        found = {"raised": traceback.format_exc()}
    out[folder.name] = found
print(json.dumps(out))
"""


@pytest.fixture(scope="module")
def outcomes(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[str, bool, dict[str, Any]]]:
    """Mutant -> what it comes from, whether it may be the same data, and what a process of its own made of it."""
    root = tmp_path_factory.mktemp("good")
    folders = tmp_path_factory.mktemp("mutants")
    beside = write_recording(BESIDE, root / "T2-s000.h5").read_bytes()
    made: dict[str, tuple[str, bool, str]] = {}
    for number, (name, base, make, may_hold) in zip(range(MUTANTS), mutants(root), strict=False):
        folder = folders / f"{number:03d}"
        folder.mkdir()
        if number % BESIDE_EVERY == 0:
            (folder / "T2-s000.h5").write_bytes(beside)
        (folder / "T1-s000.h5").touch()
        make(folder / "T1-s000.h5")
        assert name not in made
        made[name] = (base, may_hold, folder.name)
    done = subprocess.run(
        [sys.executable, "-c", CHILD, str(folders), str(MEMORY_BYTES)],
        env={**os.environ, "PYTHONPATH": str(Path(carecontact.__file__).parents[1]), "OPENBLAS_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, f"died at mutant {done.stderr[-2000:]}"
    found = json.loads(done.stdout.splitlines()[-1])
    return {name: (base, may_hold, found[folder]) for name, (base, may_hold, folder) in made.items()}


def test_there_are_two_hundred_of_every_kind(outcomes: dict[str, Any]) -> None:
    assert len(outcomes) == MUTANTS
    assert sum(name.startswith("flipped") for name in outcomes) >= 30
    assert sum(name.startswith("truncated") for name in outcomes) >= 6


def test_none_ends_in_a_traceback_or_a_hang(outcomes: dict[str, Any]) -> None:
    raised = {name: found["raised"] for name, (_, _, found) in outcomes.items() if "raised" in found}
    assert raised == {}


def test_each_is_named_or_the_same_data_still(outcomes: dict[str, Any]) -> None:
    expected = {name: score_recording(r) for name, r in GOOD.items()}
    assert {name: score.recording_sha256 for name, score in expected.items()} == {
        name: canonical_hash(r) for name, r in GOOD.items()
    }
    wrong: dict[str, object] = {}
    for name, (base, may_hold, found) in outcomes.items():
        why = found["skipped"].get("T1-s000.h5")
        if why is not None:
            if not why.strip() or "\n" in why or "T1-s000" not in why or not why.isprintable():
                wrong[name] = why
            continue
        if not may_hold or TrialScore.model_validate_json(found["scores"]["T1-s000"]) != expected[base]:
            wrong[name] = "scored"
    assert wrong == {}


def test_good_recordings_beside_them_score_as_ever(outcomes: dict[str, Any]) -> None:
    expected = score_recording(BESIDE)
    found = [scores["T2-s000"] for _, _, one in outcomes.values() if "T2-s000" in (scores := one.get("scores", {}))]
    assert len(found) == MUTANTS // BESIDE_EVERY
    assert {TrialScore.model_validate_json(score) == expected for score in found} == {True}


def test_what_is_harmless_passes(outcomes: dict[str, Any]) -> None:
    """Otherwise a reader that refuses everything would do."""
    passed = {name for name, (_, _, found) in outcomes.items() if "T1-s000" in found["scores"]}
    assert {f"harmless, {name}" for name in HARMLESS} <= passed


def test_a_score_rests_on_every_number_that_reaches_it(tmp_path: Path) -> None:
    """Of a push whose force alone is altered, with a checksum that holds, another score comes: the test above sees."""
    altered = push(force=9.0)
    assert score_recording(altered) != score_recording(push())

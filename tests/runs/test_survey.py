"""Which recordings of a folder another command keeps, from their headers alone."""

from __future__ import annotations

from pathlib import Path

import h5py
import pytest

from carecontact.recording import Failure, write_recording
from carecontact.recording.schema import KILLED, POLICY_KILLED
from carecontact.runs import score_run, write_scores
from carecontact.runs.identity import Identity
from carecontact.runs.manifest import Survey, survey
from tests.scoring.synthetic import touch

SPECS = [touch(seed=seed).header.spec for seed in range(3)]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for seed in range(2):
        write_recording(touch(seed=seed), tmp_path / f"T1-s{seed:03d}.h5")
    return tmp_path


def surveyed(folder: Path) -> Survey:
    identity = Identity(policy_sha256=None, versions={}, sha256={})
    return survey(SPECS, out=folder, retry_failed=False, identity=identity)


def flip(path: Path, dataset: str) -> None:
    with h5py.File(path) as content:
        chunk = content[dataset].id.get_chunk_info(0)
    damaged = bytearray(path.read_bytes())
    damaged[chunk.byte_offset + chunk.size // 2] ^= 1
    path.write_bytes(damaged)


def test_whole_files_are_kept_and_cut_ones_run_again(folder: Path) -> None:
    path = folder / "T1-s001.h5"
    path.write_bytes(path.read_bytes()[:-100])
    found = surveyed(folder)
    assert found.keep == {"T1-s000": "done"}
    assert "T1-s001.h5: not a readable HDF5 file" in found.redo["T1-s001"]


@pytest.mark.parametrize(
    ("ended", "kind", "again", "killed"),
    [
        ("harness_error", "settle", True, False), ("harness_error", KILLED, True, True),
        ("process_failure", POLICY_KILLED, True, True), ("process_failure", "died", False, False),
    ],
)  # fmt: skip
def test_what_the_machine_caused_runs_again_and_what_the_policy_caused_is_kept(
    folder: Path, ended: str, kind: str, again: bool, killed: bool
) -> None:
    failed = touch(seed=1, ended=ended, failure=Failure(kind=kind, message="no reason"))
    write_recording(failed, folder / "T1-s001.h5")
    found = surveyed(folder)
    assert ("T1-s001" in found.redo, "T1-s001" in found.killed) == (again, killed)


def test_a_copy_of_another_trial_runs_again(folder: Path) -> None:
    (folder / "T1-s002.h5").write_bytes((folder / "T1-s000.h5").read_bytes())
    assert surveyed(folder).redo == {"T1-s002": "T1-s002.h5 holds trial T1-s000"}


def test_damage_inside_an_array_runs_again_once_a_scoring_found_it(folder: Path) -> None:
    flip(folder / "T1-s001.h5", "scorer/force_human_from_robot_in_world")
    assert surveyed(folder).redo == {}
    run = score_run(folder)
    assert list(run.skipped) == ["T1-s001.h5"], "no damaged recording becomes a number"
    write_scores(folder, run)
    assert "damaged" in surveyed(folder).redo["T1-s001"]

from __future__ import annotations

import errno
import fcntl
import os
import subprocess
import sys
from pathlib import Path

import pytest

from carecontact.serving.sandbox import private_folder, remove_abandoned_folders


@pytest.fixture(autouse=True)
def _here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))


def test_a_folder_in_use_stays_and_one_whose_harness_was_killed_goes(tmp_path: Path) -> None:
    code = (
        "import os, sys, tempfile; tempfile.tempdir = sys.argv[1]\n"
        "from carecontact.serving.sandbox import private_folder\n"
        "(private_folder().path / 'kept').touch(); os.kill(os.getpid(), 9)"
    )
    ours = private_folder()
    subprocess.run([sys.executable, "-c", code, str(tmp_path)], check=False)
    assert len(list(tmp_path.iterdir())) == 2
    remove_abandoned_folders()
    assert list(tmp_path.iterdir()) == [ours.path]
    ours.remove()
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("number", [errno.ENOLCK, errno.EBADF])
def test_a_folder_in_use_stays_where_the_file_system_has_no_locks(
    number: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(file: object, operation: int) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(fcntl, "flock", refused)
    made = private_folder()
    remove_abandoned_folders()
    assert list(tmp_path.iterdir()) == [made.path]
    made.remove()
    assert not list(tmp_path.iterdir())


def test_each_is_new(tmp_path: Path) -> None:
    one, other = private_folder(), private_folder()
    assert one.path != other.path
    assert one.path.is_dir()
    one.remove()
    other.remove()


def test_no_folder_lies_in_shared_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every policy may read and write all of it, so that a policy would see those of parallel trials."""
    (tmp_path / "shm" / "mine").mkdir(parents=True)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "shm" / "mine"))
    monkeypatch.setattr("carecontact.serving.sandbox.SHARED_MEMORY", str(tmp_path / "shm"))
    monkeypatch.setattr("carecontact.serving.sandbox.BESIDE_SHARED_MEMORY", str(tmp_path))
    made = private_folder()
    assert made.path.parent == tmp_path
    made.remove()


def test_however_deep_a_policys_folders_are_they_go(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Deeper than Python's recursion, and without a path that a system call would take (4,096 bytes)."""
    monkeypatch.setattr("carecontact.serving.sandbox.REMOVAL_S", 120.0)  # Of a disk with other work.
    made = private_folder()
    place = os.open(made.path, os.O_RDONLY)
    for _ in range(2100):
        os.mkdir("d", dir_fd=place)
        inside = os.open("d", os.O_RDONLY, dir_fd=place)
        os.close(place)
        place = inside
    os.close(place)
    made.remove()
    assert not list(tmp_path.iterdir())


def test_folders_without_rights_go(tmp_path: Path) -> None:
    """For an ordinary user; root needs no rights."""
    made = private_folder()
    (made.path / "one" / "two").mkdir(parents=True)
    (made.path / "one" / "two" / "file").touch()
    (made.path / "one" / "two").chmod(0)
    (made.path / "one").chmod(0)
    made.remove()
    assert not list(tmp_path.iterdir())

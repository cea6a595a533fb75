"""One command at a time in a folder, and nothing left of the lock."""

from __future__ import annotations

import errno
import fcntl
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from carecontact.cli import main
from carecontact.errors import ConfigError, StorageError
from carecontact.runs.lock import LOCK, folder_lock

HOLDER = """
import sys, time
from pathlib import Path
from carecontact.runs.lock import folder_lock as alone
with alone(Path(sys.argv[1]), make=True):
    print("held", flush=True)
    time.sleep(600)
"""
RACER = """
import sys, time
from pathlib import Path
from carecontact.errors import ConfigError
from carecontact.runs.lock import folder_lock as alone
folder = Path(sys.argv[1])
for _ in range(200):
    try:
        with alone(folder, make=True):
            inside = folder.with_name("inside")
            inside.open("x").close()
            inside.unlink()
    except ConfigError as error:
        assert "process" in str(error) or "another command" in str(error), error
"""


def holder(folder: Path) -> subprocess.Popen[bytes]:
    process = subprocess.Popen([sys.executable, "-c", HOLDER, str(folder)], stdout=subprocess.PIPE)
    assert process.stdout is not None
    assert process.stdout.readline() == b"held\n"
    return process


def test_the_second_one_learns_who_holds_the_folder_and_a_kill_frees_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "run"
    with holder(folder) as first:
        commands = {
            "run": ["run", "--policy", "hover", "--out", str(folder), "--tasks", "T1", "--seeds", "0"],
            "restart": ["run", "--policy", "hover", "--out", str(folder), "--restart"],
            "score": ["report", "--rescore", str(folder)],
            "append": ["report", "--rescore", str(folder), "--append"],
            "report": ["report", str(folder)],
            "demo": ["run", "--demo", "--out", str(folder)],
        }
        for name, command in commands.items():
            assert main(command) == 2, name
            message = capsys.readouterr().err
            assert message.startswith(f"error: {folder}: process {first.pid}, since 20"), name
            assert message.endswith("is at work in this folder; wait until it has ended\n"), name
            assert message.count("\n") == 1, name
        assert sorted(path.name for path in folder.iterdir()) == [LOCK]
        os.kill(first.pid, signal.SIGKILL)
    with folder_lock(folder):
        assert (folder / LOCK).read_text().startswith(f"process {os.getpid()}, since 20")
    assert not list(folder.iterdir())


def test_commands_of_one_process_nest_and_an_empty_folder_goes_again(tmp_path: Path) -> None:
    folder = tmp_path / "new" / "run"
    with folder_lock(folder, make=True):
        with folder_lock(folder):
            pass
        assert (folder / LOCK).exists()
    assert not folder.exists()
    with folder_lock(folder):
        assert not folder.exists()


def test_a_folder_that_is_moved_away_is_locked_again(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    with folder_lock(folder, make=True):
        folder.rename(tmp_path / "moved")
        with folder_lock(folder, make=True):
            (folder / "kept").touch()
        assert not (folder / LOCK).exists()
        holder(folder).kill()
    assert (folder / LOCK).exists(), "the lock of another is left alone"


def test_two_are_never_inside_together(tmp_path: Path) -> None:
    """The folder goes and comes again two hundred times in each of four processes."""
    racers = [subprocess.Popen([sys.executable, "-c", RACER, str(tmp_path / "run")]) for _ in range(4)]
    assert [racer.wait(60) for racer in racers] == [0, 0, 0, 0]
    assert not (tmp_path / "run" / LOCK).exists()


def test_a_folder_without_space_is_named_with_what_to_do(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(handle: int, data: bytes) -> int:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patch:
        patch.setattr(os, "write", full)
        with (
            pytest.raises(StorageError, match=f"^{tmp_path}: No space left on device; free some"),
            folder_lock(tmp_path),
        ):
            pass
        assert not list(tmp_path.iterdir()), "the file of a lock that no command has"
        with pytest.raises(StorageError), folder_lock(tmp_path / "new", make=True):
            pass
        assert not list(tmp_path.iterdir())
    with folder_lock(tmp_path):
        pass
    assert not list(tmp_path.iterdir())


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_folder_without_leave_to_write_is_named(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    with pytest.raises(ConfigError, match="cannot be written to: Permission denied"), folder_lock(tmp_path):
        pass


@pytest.mark.parametrize("number", [errno.ENOLCK, errno.EOPNOTSUPP, errno.ENOSYS])
def test_without_locks_of_the_file_system_the_file_itself_is_the_lock(
    number: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(file: object, operation: int) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(fcntl, "flock", refused)
    folder = tmp_path / "run"
    with folder_lock(folder, make=True):
        with folder_lock(folder):
            pass
        assert (folder / LOCK).read_text().startswith(f"process {os.getpid()} of ")
        (folder / "kept").touch()
    assert sorted(path.name for path in folder.iterdir()) == ["kept"]

    (folder / LOCK).write_text("process 7 of elsewhere, since 2026-01-01 00:00:00,")
    message = (
        f"^{folder}: process 7 of elsewhere, since 2026-01-01 00:00:00, is at work in this folder; wait until it has "
        rf"ended; if it was killed, delete {folder / LOCK}, since this file system has no locks \({os.strerror(number)}"
    )
    for _ in range(2):
        with pytest.raises(ConfigError, match=message), folder_lock(folder):
            pass
    (folder / LOCK).unlink()
    with folder_lock(folder):
        pass


def test_a_name_behind_a_link_that_is_no_text_is_refused(tmp_path: Path) -> None:
    """No recording and no message to a worker could hold it."""
    place = os.fsencode(tmp_path) + b"/d\xff"
    os.mkdir(place)
    os.symlink(place, tmp_path / "link")
    with (
        pytest.raises(ConfigError, match=r"d\\udcff/run' holds bytes that are not UTF-8"),
        folder_lock(tmp_path / "link" / "run", make=True),
    ):
        pass
    assert not os.listdir(place)

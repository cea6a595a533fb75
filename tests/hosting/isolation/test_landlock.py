from __future__ import annotations

import os
import struct
import subprocess
import sys
from pathlib import Path

import pytest

import carecontact
from carecontact.hosting.isolation import landlock
from carecontact.hosting.isolation.landlock import (
    CREATE_RULESET,
    RESOLVE_SOCKET,
    SCOPES_SINCE,
    VERSION_FLAG,
    confine_signals,
    restrict,
    version,
)


@pytest.mark.parametrize(("version", "taken"), [(8, False), (9, True)])
def test_a_right_that_the_kernel_does_not_know_is_not_asked_for(
    version: int, taken: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It would refuse all of it."""
    handled: list[int] = []

    def kernel(number: int, *arguments: object) -> int:
        if number == CREATE_RULESET and arguments[-1] == VERSION_FLAG:
            return version
        attributes = arguments[0]
        assert isinstance(attributes, bytes)
        handled.append(struct.unpack("=QQQ", attributes)[0])
        return -1

    monkeypatch.setattr(landlock, "_call", kernel)
    assert restrict({"/usr": landlock.READ}) == 0
    assert bool(handled[0] & RESOLVE_SOCKET) is taken


@pytest.mark.skipif(version() < SCOPES_SINCE, reason="this kernel's Landlock has no scopes")
def test_a_confined_process_signals_its_own_alone_and_moves_files_as_before(tmp_path: Path) -> None:
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
    (tmp_path / "one" / "file").touch()
    code = (
        "import os, signal, sys, time; sys.path.insert(0, sys.argv[1])\n"
        "from carecontact.hosting.isolation.landlock import confine_signals\n"
        "before = os.fork() or time.sleep(60)\n"
        "assert confine_signals()\n"
        "after = os.fork() or time.sleep(60)\n"
        "for other in (before, os.getppid()):\n"
        "    try: os.kill(other, 0)\n"
        "    except PermissionError: pass\n"
        "    else: os._exit(1)\n"
        "os.kill(-1, signal.SIGKILL)\n"
        "assert os.waitstatus_to_exitcode(os.waitpid(after, 0)[1]) == -9\n"
        "assert os.waitpid(before, os.WNOHANG)[0] == 0\n"
        "os.rename('one/file', 'two/file')\n"
        "open('before', 'w').write(str(before))"
    )
    root = str(Path(carecontact.__file__).parents[1])
    assert subprocess.run([sys.executable, "-c", code, root], cwd=tmp_path, timeout=60, check=False).returncode == 0
    os.kill(int((tmp_path / "before").read_text()), 9)


def test_signals_are_not_confined_where_the_kernel_cannot(monkeypatch: pytest.MonkeyPatch) -> None:
    called: list[int] = []

    def kernel(number: int, *arguments: object) -> int:
        called.append(number)
        return SCOPES_SINCE - 1

    monkeypatch.setattr(landlock, "_call", kernel)
    assert not confine_signals()
    assert called == [CREATE_RULESET]

"""The processes that a policy started are found and killed, also while they start others."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

import carecontact
from carecontact.hosting import descendants
from carecontact.hosting.descendants import removals
from carecontact.hosting.isolation.private_folder import REMOVER
from tests.hosting.conftest import CHAIN

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="Linux lets a process adopt orphans")


def runs(beat: Path) -> bool:
    """Whether a chain of processes still writes to this file."""
    before = beat.read_bytes()
    time.sleep(0.3)
    return beat.read_bytes() != before


def python(code: str, *arguments: str) -> int:
    root = str(Path(carecontact.__file__).parents[1])
    return subprocess.run(
        [sys.executable, "-c", f"import sys; sys.path.insert(0, {root!r})\n{code}", *arguments], timeout=60, check=False
    ).returncode


@pytest.mark.parametrize("lists", ["children", "nothing"])
def test_processes_that_fork_and_end_at_once_are_killed(tmp_path: Path, lists: str) -> None:
    """``lists``: whether the kernel lists the children of a process; where it does not, /proc is searched."""
    beat = tmp_path / "beat"
    beat.touch()
    pause_s = "0" if lists == "children" else "0.02"
    assert (
        python(
            "import os, time; from pathlib import Path\n"
            "from carecontact.own_process import adopt_orphans\n"
            "from carecontact.hosting import descendants\n"
            f"{CHAIN}\n"
            "if sys.argv[3] == 'nothing': descendants._TASKS = '/nowhere'\n"
            "adopt_orphans()\n"
            "for n in range(3): chain(sys.argv[1], pause_s=float(sys.argv[2]))\n"
            "while not Path(sys.argv[1]).read_bytes(): time.sleep(0.01)\n"
            "descendants.kill_children({})\n",
            str(beat),
            pause_s,
            lists,
        )
        == 0
    )
    assert not runs(beat)


def test_the_status_of_a_child_that_is_killed_or_has_ended_is_told() -> None:
    assert (
        python(
            "import os, signal, time\n"
            "from carecontact.hosting.descendants import kill_children, reap\n"
            "one, two, other = (os.fork() or (n and time.sleep(60)) or os._exit(7) for n in range(3))\n"
            "statuses = {one: None, two: None}\n"
            "while statuses[one] is None: assert not reap(statuses)\n"
            "kill_children(statuses)\n"
            "assert statuses == {one: 7, two: -9}, statuses\n"
            "try: reap(statuses)\n"
            "except ChildProcessError: os._exit(0)\n"
            "os._exit(1)\n"
        )
        == 0
    )


def test_no_more_children_are_reaped_than_are_asked_for() -> None:
    assert (
        python(
            "import os, time\n"
            "from carecontact.hosting.descendants import reap\n"
            "for _ in range(3): os.fork() or os._exit(0)\n"
            "time.sleep(0.5)\n"
            "assert reap({}, most=2)\n"
            "try: reap({}, most=2)\n"
            "except ChildProcessError: os._exit(0)\n"
            "os._exit(1)\n"
        )
        == 0
    )


def test_marks_of_one_process_are_not_those_of_another() -> None:
    assert descendants.new_mark().startswith(descendants.marks_of(os.getpid()))
    assert not descendants.marks_of(123).startswith(descendants.marks_of(12))


@pytest.mark.skipif(sys.platform != "linux", reason="reads names of processes in /proc")
def test_processes_that_remove_folders_are_counted_and_reaped() -> None:
    """Each would stay as a zombie of the command, and count against the processes that its user may have."""
    code = f"{{ printf {REMOVER} > /proc/self/comm; }}; echo; read -r line"
    remover = subprocess.Popen(["sh", "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    other = subprocess.Popen(["true"])
    assert remover.stdout is not None
    assert remover.stdin is not None
    remover.stdout.readline()
    assert removals() == 1
    remover.stdin.close()
    until = time.monotonic() + 10.0
    while removals() and time.monotonic() < until:
        time.sleep(0.01)
    assert not Path(f"/proc/{remover.pid}").exists()
    assert other.wait() == 0
    remover.stdout.close()

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="what the kernel of Linux is asked")


def said(code: str, *arguments: str) -> str:
    code = f"import os, sys\nfrom carecontact.own_process import *\n{code}"
    return subprocess.run([sys.executable, "-c", code, *arguments], capture_output=True, text=True, check=False).stdout


def test_options_are_hidden_and_the_program_is_not() -> None:
    shown = said(
        "hide_options(sys.argv[1:])\nprint(open('/proc/self/cmdline').read().split(chr(0)), sys.argv[1:])",
        "run", "--tasks", "T1", "--seeds", "ü7",
    )  # fmt: skip
    hidden, kept = shown.rstrip().split("] [")
    assert "'run'" in hidden
    assert not [word for word in ("tasks", "T1", "seeds", "7") if word in hidden.rpartition("'run'")[2]]
    assert kept == "'run', '--tasks', 'T1', '--seeds', 'ü7']"


def test_another_command_line_is_left_alone() -> None:
    shown = said(
        "hide_options(['run', '--tasks', 'T2'])\nprint(open('/proc/self/cmdline').read())", "run", "--tasks", "T1"
    )
    assert shown.rstrip("\n").endswith("run\0--tasks\0T1\0")


def test_a_process_whose_parent_is_gone_already_ends() -> None:
    assert said("die_with_parent(os.getppid()); print('lives')") == "lives\n"
    assert said("die_with_parent(os.getppid() + 1); print('lives')") == ""


def test_memory_is_hidden() -> None:
    code = "hide_memory(); import ctypes; print(ctypes.CDLL(None).prctl(3, 0, 0, 0, 0))"
    assert said(code) == "0\n"


@pytest.mark.skipif(os.geteuid() != 0, reason="only root has something to give up")
def test_what_root_gave_up_no_program_gives_back() -> None:
    code = (
        "import ctypes; drop_capabilities(); ctypes.CDLL(None).prctl(38, 1, 0, 0, 0)\n"
        "os.execv('/bin/cat', ['cat', '/proc/self/status'])"
    )
    status = dict(line.split(":\t") for line in said(code).splitlines() if ":\t" in line)
    assert {int(status[name], 16) for name in ("CapEff", "CapPrm")} == {2}
    assert int(Path("/proc/self/status").read_text().partition("CapEff:\t")[2].split()[0], 16) != 2

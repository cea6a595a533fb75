from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="what the kernel of Linux is asked")


def printed(code: str, *arguments: str) -> str:
    code = f"import os, sys\nfrom carecontact.system import *\n{code}"
    return subprocess.run([sys.executable, "-c", code, *arguments], capture_output=True, text=True, check=False).stdout


def test_a_process_whose_parent_is_gone_already_ends() -> None:
    assert printed("die_with_parent(os.getppid()); print('lives')") == "lives\n"
    assert printed("die_with_parent(os.getppid() + 1); print('lives')") == ""


@pytest.mark.skipif(os.geteuid() != 0, reason="only root has something to give up")
def test_what_root_gave_up_no_program_gives_back() -> None:
    code = (
        "import ctypes; drop_capabilities(); ctypes.CDLL(None).prctl(38, 1, 0, 0, 0)\n"
        "os.execv('/bin/cat', ['cat', '/proc/self/status'])"
    )
    status = dict(line.split(":\t") for line in printed(code).splitlines() if ":\t" in line)
    assert {int(status[name], 16) for name in ("CapEff", "CapPrm")} == {2}
    assert int(Path("/proc/self/status").read_text().partition("CapEff:\t")[2].split()[0], 16) != 2

from __future__ import annotations

import subprocess
import sys

import pytest

from carecontact.hosting.isolation import limits
from carecontact.hosting.isolation.fence import level

ITSELF_AND_ITS_PARENT = """
import os, resource, subprocess
from carecontact.hosting.isolation.limits import close_limits
print(close_limits())
resource.setrlimit(resource.RLIMIT_NOFILE, (100, 100))
print(subprocess.check_output(["sh", "-c", "ulimit -n"], text=True).strip())
try:
    resource.prlimit(os.getppid(), resource.RLIMIT_NOFILE)
except PermissionError:
    print("refused")
"""


@pytest.mark.skipif(not limits.can_close_limits(), reason="this system does not filter system calls")
def test_a_process_sets_its_own_limits_and_no_other_ones() -> None:
    told = subprocess.check_output([sys.executable, "-c", ITSELF_AND_ITS_PARENT], text=True)
    assert told.split() == ["True", "100", "refused"]


def test_without_it_isolation_is_not_full(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(limits, "SECCOMP", {})
    assert not limits.can_close_limits()
    assert not limits.close_limits()
    assert level(6, limits=True) == "full"
    assert level(6, limits=False).startswith("partial: ")

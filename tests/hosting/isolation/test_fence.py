from __future__ import annotations

import json
import os
import shutil
import socket
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import carecontact
from carecontact.cache_folder import CACHE_VARIABLE
from carecontact.contract.policy_ref import PolicyRef
from carecontact.hosting.isolation.fence import available, level
from carecontact.hosting.isolation.landlock import version
from carecontact.hosting.process import PolicyProcess
from carecontact.hosting.setup import PolicySetup
from tests.hosting.isolation import leaks
from tests.policies.synthetic import SESSION

Try = Callable[..., dict[str, Any]]

SINCE_SCOPES = {
    "signal the harness", "signal the harness through a child", "connect to an abstract socket",
}  # fmt: skip
OF_PROCESSES = {
    "limit the files of the harness", "limit the processor time of the harness through a child",
    "change the harness's priority at the disk", "processor time of the harness",
}  # fmt: skip
"""Closed where the policy does not see the process."""
HIDDEN = {
    "learn that a process exists", "learn how many files the harness holds open",
    "change the priority of the harness", "bind the harness to processors",
}  # fmt: skip
"""Open otherwise."""
SINCE_RESOLVE = {"connect to a socket with a path"}
PRIORITY = {"change the priority of the harness", "bind the harness to processors"}
"""Closed to root's policy, which has fewer privileges than the harness."""
TRACING = {
    "variables of the harness", "memory of the harness", "map of the harness's memory", "working folder of the harness",
    "list the files that the harness holds open", "trace the harness", "copy memory of the harness",
    "take a descriptor of the harness",
}  # fmt: skip
"""What some systems close to any process that is no ancestor, with or without Landlock."""
needs_landlock = pytest.mark.skipif(not version(), reason="this system has no Landlock")


@pytest.fixture
def attempt(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Try:
    folder = tmp_path / "policy"
    (folder / "cache" / "settled").mkdir(parents=True)
    for name in ("settled/person.npz", "secret"):
        (folder / "cache" / name).write_text("secret")
    monkeypatch.setenv(CACHE_VARIABLE, str(folder / "cache"))
    for run in ("now", "earlier"):
        (folder / "runs" / run).mkdir(parents=True)
        for name in ("T1-s000.h5", "manifest.json"):
            (folder / "runs" / run / name).write_text("seed 3")
    (tmp_path / "outside").mkdir()
    (tmp_path / "outside" / "secret").write_text("secret")
    shutil.copy(leaks.__file__, folder / "leaks.py")

    def run_it(*, watcher: bool = False, **given: Any) -> dict[str, Any]:
        name = f"carecontact-test-{os.getpid()}"
        setup = PolicySetup(
            ref=PolicyRef.parse("leaks:Leaks"), search_path=(str(folder),),
            arguments={"socket_name": name, "harness": str(0 if watcher else os.getpid())},
            closed=tuple(str(folder / "runs" / run) for run in ("now", "earlier")), **given,
        )  # fmt: skip
        named = tmp_path / "outside" / "socket"
        named.unlink(missing_ok=True)
        with socket.socket(socket.AF_UNIX) as listener, socket.socket(socket.AF_UNIX) as other:
            listener.bind(f"\0{name}")
            other.bind(str(named))
            listener.listen()
            other.listen()
            with PolicyProcess(setup, first_deadline_s=60, deadline_s=60) as process:
                process.start()
                process.reset("touch", SESSION)
                process.close()
                return {**json.loads(process.printed), "isolation": process.isolation}

    return run_it


@needs_landlock
@pytest.mark.parametrize("watcher", [False, True], ids=["harness", "watcher"])
def test_a_policy_gets_nothing_of_what_is_said_to_be_closed(
    attempt: Try, tmp_path: Path, watcher: bool, sandbox: bool
) -> None:
    told = attempt(watcher=watcher)
    expected = set(leaks.tries(tmp_path, "", 0)) - (SINCE_SCOPES if version() < 6 and not sandbox else set())
    expected |= SINCE_RESOLVE if version() >= 9 else set()
    expected |= HIDDEN if sandbox and not watcher else set()
    expected -= set() if sandbox and not watcher else OF_PROCESSES
    assert {name for name, said in told["said"].items() if said == "open"} & expected == set()
    assert told["isolation"] == available()
    assert not [path for path in told["files"] if not path.startswith("/proc/")], "descriptors of the harness"
    assert all(told["caches"]), "libraries keep what they compile where the policy may write"
    # Every thread: a policy could otherwise let one that is free act for it.
    assert {thread["NoNewPrivs"] for thread in told["threads"]} == {"1"}
    assert {int(thread["CapEff"], 16) for thread in told["threads"]} == {2 if os.geteuid() == 0 else 0}


@pytest.mark.parametrize("watcher", [False, True], ids=["harness", "watcher"])
def test_without_isolation_it_gets_all_of_it(attempt: Try, tmp_path: Path, watcher: bool) -> None:
    """So that the test above can fail."""
    told = attempt(isolated=False, watcher=watcher)
    expected = set(leaks.tries(tmp_path, "", 0))
    if os.geteuid() != 0:
        expected -= TRACING
    if not os.access(Path(carecontact.__file__).parent, os.W_OK):
        expected -= {"write into the package", "add a module to the package"}
    assert {name for name in expected if told["said"][name] != "open"} == set()
    assert told["isolation"] == "none: switched off"


@needs_landlock
def test_what_stays_open(attempt: Try, tmp_path: Path, sandbox: bool) -> None:
    """docs/threat-model.md names it."""
    told = attempt()
    expected = set(leaks.stays_open(tmp_path, 0)) - (PRIORITY if os.geteuid() == 0 else set())
    expected -= SINCE_RESOLVE if version() >= 9 or (sandbox and tmp_path.is_relative_to("/tmp")) else set()
    expected -= HIDDEN if sandbox else set()
    if Path(carecontact.__file__).stat().st_uid != os.geteuid():
        expected -= {"hold a lease on a file that the harness opens"}
    assert {name for name in expected if told["said"][name] != "open"} == set()


@pytest.mark.parametrize(
    ("kernel", "namespaces", "word", "says"),
    [
        (6, True, "full", "namespaces and Landlock"),
        (6, False, "partial", "Landlock without namespaces"),
        (3, False, "partial", "without namespaces, and signals"),
        (2, True, "partial", "emptying a file"),
        (0, True, "partial", "namespaces without Landlock"),
        (0, False, "none", "neither namespaces nor Landlock"),
    ],
)
def test_the_level_is_named(kernel: int, namespaces: bool, word: str, says: str) -> None:
    found, _, why = level(kernel, namespaces=namespaces).partition(": ")
    assert found == word
    assert says in why
    assert ";" not in why, "what follows one is what the user opened"

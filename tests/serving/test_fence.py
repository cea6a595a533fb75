from __future__ import annotations

import json
import os
import shutil
import socket
import struct
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest

import carecontact
from carecontact.interface.policy import PolicyRef
from carecontact.serving import fence
from carecontact.serving.conversation import PolicySetup
from carecontact.serving.fence import (
    CREATE_RULESET,
    READ,
    RESOLVE_SOCKET,
    SYSTEM,
    VERSION_FLAG,
    WRITE,
    WRITE_FILE,
    Allowed,
    UnlistedFolders,
    allowed,
    available,
    level,
    own_rights,
    restrict,
    version,
    without,
)
from carecontact.serving.process import PolicyProcess
from carecontact.system import CACHE_VARIABLE
from tests.policies.synthetic import SESSION
from tests.serving import leaks

Try = Callable[..., dict[str, Any]]

SINCE_SCOPES = {"signal the harness", "signal the harness through a child", "connect to an abstract socket"}
OF_PROCESSES = {
    "limit the files of the harness",
    "limit the processor time of the harness through a child",
    "change the harness's priority at the disk",
    "processor time of the harness",
}
"""Closed where the policy does not see the process."""
HIDDEN = {
    "learn that a process exists",
    "learn how many files the harness holds open",
    "change the priority of the harness",
    "bind the harness to processors",
}
"""Open otherwise."""
SINCE_RESOLVE = {"connect to a socket with a path"}
PRIORITY = {"change the priority of the harness", "bind the harness to processors"}
"""Closed to root's policy, which has fewer privileges than the harness."""
TRACING = {
    "variables of the harness",
    "memory of the harness",
    "map of the harness's memory",
    "working folder of the harness",
    "list the files that the harness holds open",
    "trace the harness",
    "copy memory of the harness",
    "take a descriptor of the harness",
}
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
            ref=PolicyRef.parse("leaks:Leaks"),
            search_path=(str(folder),),
            arguments={"socket_name": name, "harness": str(0 if watcher else os.getpid())},
            closed=tuple(str(folder / "runs" / run) for run in ("now", "earlier")),
            **given,
        )
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
def test_a_policy_gets_nothing_of_what_the_threat_model_closes(
    attempt: Try, tmp_path: Path, watcher: bool, sandbox: bool
) -> None:
    found = attempt(watcher=watcher)
    expected = set(leaks.tries(tmp_path, "", 0)) - (SINCE_SCOPES if version() < 6 and not sandbox else set())
    expected |= SINCE_RESOLVE if version() >= 9 else set()
    expected |= HIDDEN if sandbox and not watcher else set()
    expected -= set() if sandbox and not watcher else OF_PROCESSES
    assert {name for name, result in found["results"].items() if result == "open"} & expected == set()
    assert found["isolation"] == available()
    assert not [path for path in found["files"] if not path.startswith("/proc/")], "descriptors of the harness"
    assert all(found["caches"]), "libraries keep what they compile where the policy may write"
    # Every thread: a policy could otherwise let one that is free act for it.
    assert {thread["NoNewPrivs"] for thread in found["threads"]} == {"1"}
    assert {int(thread["CapEff"], 16) for thread in found["threads"]} == {2 if os.geteuid() == 0 else 0}


@pytest.mark.parametrize("watcher", [False, True], ids=["harness", "watcher"])
def test_without_isolation_it_gets_all_of_it(attempt: Try, tmp_path: Path, watcher: bool) -> None:
    """So that the test above can fail."""
    found = attempt(isolated=False, watcher=watcher)
    expected = set(leaks.tries(tmp_path, "", 0))
    if os.geteuid() != 0:
        expected -= TRACING
    if not os.access(Path(carecontact.__file__).parent, os.W_OK):
        expected -= {"write into the package", "add a module to the package"}
    assert {name for name in expected if found["results"][name] != "open"} == set()
    assert found["isolation"] == "none: switched off"


@needs_landlock
def test_what_stays_open(attempt: Try, tmp_path: Path, sandbox: bool) -> None:
    """docs/evidence/threat-model.md names it."""
    found = attempt()
    expected = set(leaks.stays_open(tmp_path, 0)) - (PRIORITY if os.geteuid() == 0 else set())
    expected -= SINCE_RESOLVE if version() >= 9 or (sandbox and tmp_path.is_relative_to("/tmp")) else set()
    expected -= HIDDEN if sandbox else set()
    if Path(carecontact.__file__).stat().st_uid != os.geteuid():
        expected -= {"hold a lease on a file that the harness opens"}
    assert {name for name in expected if found["results"][name] != "open"} == set()


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


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path.with_name("temporary")))
    for place in ("runs/now", "runs/earlier", "weights", "mine"):
        (tmp_path / place).mkdir(parents=True)
    (tmp_path / "mine" / "__init__.py").touch()
    (tmp_path / "helper.py").touch()
    (tmp_path / "up").symlink_to(tmp_path)
    (tmp_path / "outside").symlink_to("/usr")
    return tmp_path


def asked(folder: Path, **changed: Any) -> dict[str, int]:
    return asked_for(folder, **changed).rights


def asked_for(folder: Path, *, given: Sequence[str] = (), record: str | None = None, **changed: Any) -> Allowed:
    options: Any = {"search_path": [str(folder)], "target": "mine:P", "environment": [], "closed": []}
    options |= {"readable": [], "writable": [], "language": {} if record is None else {"record": record}}
    return allowed({**options, "arguments": dict(enumerate(given)), **changed})


def test_a_folder_without_what_is_closed_in_it(folder: Path) -> None:
    found = set(without(str(folder), [str(folder / "runs" / "now")]))
    assert found == {str(folder / name) for name in ("runs/earlier", "weights", "mine", "helper.py", "outside")}
    assert list(without(str(folder), ["/elsewhere"])) == [str(folder)]
    assert list(without(str(folder / "runs" / "now" / "x"), [str(folder / "runs" / "now")])) == []
    assert list(without("/", ["/"])) == []


def test_the_clocks_of_others_are_left_out_and_limits_stay_readable(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for place in ("sys/cpu0/cpuidle", "sys/cpu1/cpuidle", "sys/cpu0/topology", "sys/group"):
        (folder / place).mkdir(parents=True)
    for name in ("sys/group/cpu.max", "sys/group/cpu.stat"):
        (folder / name).touch()
    monkeypatch.setattr(fence, "SYSTEM", (f"{folder}/sys",))
    monkeypatch.setattr(fence, "CLOCKS", (f"{folder}/sys/cpu*/cpuidle", f"{folder}/sys/group"))
    monkeypatch.setattr(fence, "LIMITS", (f"{folder}/sys/group/cpu.max", f"{folder}/sys/group/memory.max"))
    found = asked(folder, search_path=[])
    here = {path.removeprefix(f"{folder}/sys/") for path in found if path.startswith(f"{folder}/sys")}
    assert here == {"cpu0/topology", "group/cpu.max"}


def test_the_machines_counters_of_processor_time_are_among_the_clocks_or_not_named() -> None:
    named = {*fence.SYSTEM, *fence.PROCESS}
    assert not {"/proc", "/proc/stat", "/proc/uptime", "/proc/loadavg", "/proc/pressure", "/proc/schedstat"} & named


def test_a_policy_reads_its_folder_its_arguments_and_the_interpreter(folder: Path, tmp_path: Path) -> None:
    replay = folder / "said.jsonl"
    replay.touch()
    found = asked(folder, given=["3", "", f"replay:{replay}", f"{folder / 'weights'}{os.pathsep}/nowhere"])
    for place in (folder, replay, folder / "weights", Path(sys.prefix).resolve()):
        assert found[str(place)] == READ, place
    assert not {"/nowhere", "3", ""} & set(found)
    assert not [path for path in ("/", "/etc", "/home", "/root", "/tmp", "/run", "/proc") if path in found]
    assert own_rights([])[f"/proc/{os.getpid()}"] & READ == READ
    assert found["/dev/null"] & WRITE_FILE


def test_places_are_named_as_the_policy_names_them(folder: Path) -> None:
    """Behind a link as well: where namespaces hide /tmp, it has to lie there again."""
    found = asked_for(folder, search_path=[str(folder / "up" / "mine")], given=[str(folder / "outside")]).places
    assert {str(folder / "up" / "mine"), str(folder / "outside")} <= set(found)


def test_what_the_user_opens(folder: Path) -> None:
    record = str(folder / "record.jsonl")
    found = asked(folder, readable=["/data"], writable=["/logs"], record=record)
    assert (found["/data"], found["/logs"] & (READ | WRITE)) == (READ, READ | WRITE)
    assert found[record] & (READ | WRITE) == READ | WRITE_FILE


def test_no_place_that_may_be_written_holds_a_run(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(folder))
    assert own_rights([])[str(folder)] & WRITE
    assert str(folder) not in own_rights([str(folder / "runs" / "now")])
    assert str(folder) not in asked(folder, closed=[str(folder / "runs" / "now")])


def test_weights_in_the_cache_are_open_and_the_users_keys_beside_them_are_not(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HOME", str(folder / "runs"))
    cache = folder / "runs" / ".cache"
    (cache / "huggingface" / "hub").mkdir(parents=True)
    (cache / "torch").mkdir()
    assert asked(folder, search_path=[])[str(cache)] == READ
    (cache / "huggingface" / "token").touch()
    found = {path for path in asked(folder, search_path=[]) if path.startswith(str(cache))}
    assert found == {str(cache / "torch"), str(cache / "huggingface" / "hub")}


def test_a_policy_in_the_home_folder_does_not_open_what_is_hidden_there(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in (".ssh", ".venv/lib"):
        (folder / name).mkdir(parents=True)
    monkeypatch.setenv("HOME", str(folder))
    found = asked(folder, given=[str(folder / ".venv" / "lib")])
    assert {str(folder / name) for name in ("mine", "helper.py", ".venv/lib")} <= set(found)
    assert not {str(folder), str(folder / ".ssh")} & set(found)
    monkeypatch.setenv("HOME", str(folder / "mine"))
    (folder / "mine" / ".ssh").mkdir()
    found = asked(folder)
    assert str(folder / "helper.py") in found
    assert not {str(folder / name) for name in ("", "mine", "mine/.ssh")} & set(found)


def test_the_package_of_a_policy_that_is_installed_elsewhere(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As an editable installation has it: a finder knows where, and ``sys.path`` does not."""
    elsewhere = folder / "weights"
    (elsewhere / "editable_policy.py").touch()

    class Finder:
        @staticmethod
        def find_spec(name: str, path: object, target: object = None) -> object:
            from importlib.util import spec_from_file_location

            return (
                spec_from_file_location(name, elsewhere / "editable_policy.py") if name == "editable_policy" else None
            )

    monkeypatch.setattr(sys, "meta_path", [*sys.meta_path, Finder])
    found = asked(folder, search_path=[], target="editable_policy.part:P")
    assert found[str(elsewhere / "editable_policy.py")] == READ
    assert str(elsewhere) not in found


def test_places_of_the_system_are_narrow() -> None:
    assert not {"/", "/etc", "/home", "/root", "/tmp", "/var", "/run", "/proc", "/dev"} & set(SYSTEM)


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

    monkeypatch.setattr(fence, "_call", kernel)
    assert restrict({"/usr": fence.READ}) == 0
    assert bool(handled[0] & RESOLVE_SOCKET) is taken


def test_modules_packages_and_folders_are_found_by_name(tmp_path: Path) -> None:
    (tmp_path / "module.py").touch()
    (tmp_path / "package").mkdir()
    (tmp_path / "package" / "__init__.py").touch()
    (tmp_path / "space").mkdir()
    finder = UnlistedFolders([str(tmp_path / "empty"), str(tmp_path)])
    module, package, space = (finder.find_spec(name, None) for name in ("module", "package", "space"))
    assert module is not None
    assert module.origin == str(tmp_path / "module.py")
    assert package is not None
    assert list(package.submodule_search_locations or ()) == [str(tmp_path / "package")]
    assert space is not None
    assert list(space.submodule_search_locations or ()) == [str(tmp_path / "space")]
    assert finder.find_spec("absent", None) is None
    assert finder.find_spec("module", [str(tmp_path)]) is None, "in a package the usual finder looks"

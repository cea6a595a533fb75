from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest

from carecontact.hosting.isolation import allowlist
from carecontact.hosting.isolation.allowlist import SYSTEM, Allowed, allowed, own_rights, without
from carecontact.hosting.isolation.landlock import READ, READ_FILE, WRITE, WRITE_FILE


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


def asked(folder: Path, **changed: object) -> dict[str, int]:
    return asked_for(folder, **changed).rights


def asked_for(folder: Path, **changed: object) -> Allowed:
    given: dict[str, object] = {
        "search_path": [str(folder)], "target": "mine:P", "given": [], "readable": [], "writable": [], "closed": [],
    }  # fmt: skip
    return allowed(**{**given, **changed})  # pyright: ignore[reportArgumentType]


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
    monkeypatch.setattr(allowlist, "SYSTEM", (f"{folder}/sys",))
    monkeypatch.setattr(allowlist, "CLOCKS", (f"{folder}/sys/cpu*/cpuidle", f"{folder}/sys/group"))
    monkeypatch.setattr(allowlist, "LIMITS", (f"{folder}/sys/group/cpu.max", f"{folder}/sys/group/memory.max"))
    found = asked(folder, search_path=[])
    here = {path.removeprefix(f"{folder}/sys/") for path in found if path.startswith(f"{folder}/sys")}
    assert here == {"cpu0/topology", "group/cpu.max"}


def test_the_machines_counters_of_processor_time_are_among_the_clocks_or_not_named() -> None:
    named = {*allowlist.SYSTEM, *allowlist.PROCESS}
    assert not {"/proc", "/proc/stat", "/proc/uptime", "/proc/loadavg", "/proc/pressure", "/proc/schedstat"} & named


def test_a_policy_reads_its_folder_its_arguments_and_the_interpreter(folder: Path, tmp_path: Path) -> None:
    told = folder / "said.jsonl"
    told.touch()
    found = asked(folder, given=["3", "", f"replay:{told}", f"{folder / 'weights'}{os.pathsep}/nowhere"])
    for place in (folder, told, folder / "weights", Path(sys.prefix).resolve()):
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
    assert (found["/data"], found["/logs"] & (READ | WRITE), found[record]) == (
        READ, READ | WRITE, READ_FILE | WRITE_FILE,
    )  # fmt: skip


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

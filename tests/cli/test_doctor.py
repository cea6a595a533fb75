"""What the doctor concludes; the machine's own state is not asserted."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest

from carecontact.cli import machine
from carecontact.cli.doctor import Doctor
from carecontact.cli.machine import (
    Finding,
    apt_line,
    check_assets,
    check_extras,
    check_gl,
    check_packages,
    check_tissue,
    gl_backend,
)
from carecontact.kernel import binary, found

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize(
    ("wanted", "there", "expected"),
    [
        ("", {"libEGL.so.1", "libGL.so.1"}, ("egl", [])),
        ("", {"libEGL.so.1", "libOSMesa.so.8"}, ("osmesa", [])),
        ("", set(), ("egl", ["libEGL.so.1", "libGL.so.1"])),
        ("OSMesa", {"libEGL.so.1", "libGL.so.1"}, ("osmesa", ["libOSMesa.so.8"])),
        ("egl", {"libGL.so.1", "libOSMesa.so.8"}, ("egl", ["libEGL.so.1"])),
    ],
)
def test_backend(
    wanted: str, there: set[str], expected: tuple[str, list[str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MUJOCO_GL", wanted)
    assert gl_backend(loads=there.__contains__) == expected


def test_missing_library_is_named_with_the_line_that_installs_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    monkeypatch.setitem(machine.GL_LIBRARIES, "egl", ("libCertainlyNotHere.so.1",))
    monkeypatch.setitem(machine.GL_LIBRARIES, "osmesa", ("libNorThis.so.1",))
    finding = check_gl()
    assert not finding.fine
    assert "libCertainlyNotHere.so.1" in finding.detail
    assert (finding.fix or "").endswith("apt-get install -y libegl1 libgl1 libgl1-mesa-dri")
    assert apt_line("osmesa").endswith("apt-get install -y libosmesa6")


def test_missing_package_is_named_with_the_line_that_installs_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(machine.PACKAGES, "no-such-distribution", "no-such-distribution==1")
    finding = check_packages()
    assert not finding.fine
    assert finding.detail == "not installed: no-such-distribution"
    assert (finding.fix or "").endswith("-m pip install no-such-distribution==1")


def test_what_an_extra_would_add_is_told_and_fails_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        machine, "EXTRAS", {"tables": (("no-such-distribution",), "run.trials()"), "x": (("numpy",), "y")}
    )
    finding = check_extras()
    assert finding.fine
    assert finding.detail == (
        "optional and not installed: tables (for run.trials()); pip install 'carecontact[tables]' adds the first"
    )


def test_the_extras_are_those_of_the_package() -> None:
    declared = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    names = {extra: {re.split(r"[<>=]", line)[0] for line in lines} for extra, lines in declared.items()}
    assert {extra: set(packages) for extra, (packages, _) in machine.EXTRAS.items()} == names


def test_shipped_assets_match_their_provenance() -> None:
    finding = check_assets()
    assert finding.fine
    told = finding.detail.split(", ")
    assert {"bodies/man-adult.npz", "bodies/man-adult.skin.png", "bodies/woman-old-heavy.npz"} < set(told)
    assert told[-1] == "panda/panda.npz"


def test_the_compiled_tissue_loads_and_says_what_it_is() -> None:
    finding = check_tissue()
    assert finding.fine, finding.detail
    assert finding.detail.endswith(f"sha256 {found.sha256()[:12]}; it loads")


def test_a_stale_tissue_is_told_with_the_command_that_compiles_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(binary, "FLAGS", (*binary.FLAGS, "-O2"))
    finding = check_tissue()
    assert not finding.fine
    assert "does not belong to the C sources beside it" in finding.detail
    assert finding.fix == found.making()


def test_a_tissue_that_does_not_load_says_why(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(machine, "TISSUE_PROBE", "raise OSError('no such symbol')")
    finding = check_tissue()
    assert not finding.fine
    assert finding.detail.endswith("OSError: no such symbol")
    assert finding.fix == f"rm {found.file()} && {found.making()}"


@pytest.mark.parametrize(("fine", "status"), [(True, 0), (False, 1)])
def test_exit_status_and_output(
    fine: bool, status: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    finding = Finding(name="x", fine=fine, detail="so it is", fix=None if fine else "do this")
    for name in ("check_python", "check_packages", "check_gl", "check_frame", "check_pose", "check_assets"):
        monkeypatch.setattr(machine, name, lambda: finding)
    assert Doctor()() == status
    told = capsys.readouterr().out
    assert ("install it with: do this" in told) is not fine


@pytest.mark.parametrize(
    ("landlock", "user", "told"),
    [
        (7, 1000, ["ok   isolation  full\n"]),
        (7, 0, ["warn isolation  full; you are root, and so is every policy"]),
        (4, 1000, ["warn isolation  partial: ", "signals to the harness", "on another host"]),
        (0, 0, ["warn isolation  none: this system has no Landlock", "on another host", "you are root"]),
    ],
)
def test_isolation_that_is_not_there_is_warned_of(
    landlock: int, user: int, told: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("carecontact.hosting.isolation.fence.version", lambda: landlock)
    monkeypatch.setattr("os.geteuid", lambda: user)
    monkeypatch.setattr("carecontact.cli.machine.findings", lambda: [machine.check_isolation()])
    assert Doctor()() == 0
    said = capsys.readouterr().out
    assert all(part in said for part in told)


def test_a_socket_through_which_a_policy_may_get_out_is_warned_of(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("os.geteuid", lambda: 1000)
    found = ["/run/user/1000/bus", "/tmp/tmux-1000/default"]
    monkeypatch.setattr("carecontact.hosting.isolation.sockets.open_sockets", lambda: found)
    told = machine.check_isolation()
    assert told.warning
    assert "listen at /run/user/1000/bus and 1 other socket" in told.detail


@pytest.mark.parametrize(
    ("code", "expected"),
    [
        ("pass", None),
        ("raise SystemError('bad driver')", "SystemError: bad driver"),
        ("import os; os.abort()", "ended"),
    ],
)
def test_probe_survives_what_it_probes(code: str, expected: str | None) -> None:
    problem = machine._probe(code, environment={})
    assert problem is None if expected is None else expected in (problem or "")

"""What the doctor concludes; the machine's own state is not asserted."""

from __future__ import annotations

import pytest

from carecontact.cli import machine
from carecontact.cli.doctor import Doctor
from carecontact.cli.machine import Finding, apt_line, check_assets, check_gl, check_packages, gl_backend


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


def test_shipped_assets_match_their_provenance() -> None:
    finding = check_assets()
    assert finding.fine
    told = finding.detail.split(", ")
    assert {"bodies/man-adult.npz", "bodies/man-adult.skin.png", "bodies/woman-old-heavy.npz"} < set(told)
    assert told[-1] == "panda/panda.npz"


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

"""What the doctor concludes and prints; the machine's own state is not asserted."""

from __future__ import annotations

import pytest

from carecontact.cli.doctor import Doctor
from carecontact.trials import machine
from carecontact.trials.machine import Finding


@pytest.mark.parametrize(("fine", "status"), [(True, 0), (False, 1)])
def test_exit_status_and_output(
    fine: bool, status: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    finding = Finding(name="x", fine=fine, detail="so it is", fix=None if fine else "do this")
    for name in ("check_python", "check_packages", "check_opengl", "check_pose", "check_assets"):
        monkeypatch.setattr(machine, name, lambda **_: finding)
    assert Doctor()() == status
    told = capsys.readouterr().out
    assert ("install it with: do this" in told) is not fine


@pytest.mark.parametrize(
    ("landlock", "namespaces", "user", "told"),
    [
        (7, True, 1000, ["ok   isolation  full: namespaces and Landlock\n"]),
        (7, True, 0, ["warn isolation  full: namespaces and Landlock; you are root, and so is every policy"]),
        (7, False, 1000, ["warn isolation  partial: Landlock without namespaces; run policies"]),
        (4, False, 1000, ["warn isolation  partial: ", "signals to the harness", "on another host"]),
        (0, True, 1000, ["warn isolation  partial: namespaces without Landlock"]),
        (0, False, 0, ["warn isolation  none: neither namespaces nor Landlock", "you are root"]),
    ],
)
def test_isolation_that_is_not_there_is_warned_of(
    landlock: int,
    namespaces: bool,
    user: int,
    told: list[str],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr("carecontact.hosting.isolation.fence.version", lambda: landlock)
    monkeypatch.setattr("carecontact.hosting.isolation.fence.granted", lambda: namespaces)
    monkeypatch.setattr("os.geteuid", lambda: user)
    monkeypatch.setattr("carecontact.trials.machine.findings", lambda: [machine.check_isolation()])
    assert Doctor()() == 0
    said = capsys.readouterr().out
    assert all(part in said for part in told)

"""Recordings that carry a shipped id and other rules: every output that names the protocol says so."""

from __future__ import annotations

from pathlib import Path

import pytest

from carecontact.cli import main
from carecontact.recording import Recording, write_recording
from tests.protocols.held import HELD, ship_frozen
from tests.scoring.synthetic import touch

CHANGED = f"not the frozen {HELD} (sha256 "


def eased(recording: Recording) -> Recording:
    """A hold of 10 ms is a touch."""
    protocol = recording.header.spec.protocol
    gates = protocol.gates.model_copy(update={"touch": protocol.gates.touch.model_copy(update={"duration_s": 0.01})})
    spec = recording.header.spec.model_copy(update={"protocol": protocol.model_copy(update={"gates": gates})})
    return Recording(header=recording.header.model_copy(update={"spec": spec}), arrays=recording.arrays)


def test_score_report_and_compare_name_eased_rules(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    shipped = tmp_path / "shipped"
    shipped.mkdir()
    good = touch(seed=0, protocol=ship_frozen(monkeypatch, shipped))
    for name, made in (("good", good), ("a", eased(good)), ("b", eased(good))):
        Path(name).mkdir()
        write_recording(made, Path(name) / "T1-s000.h5")
        assert main(["score", name]) == 0
        assert (f"protocol: {HELD}, {CHANGED}" in capsys.readouterr().out) == (name != "good")
        assert main(["report", name]) == 0
        assert (f"{HELD} (not the frozen protocol)" in (Path(name) / "report.html").read_text()) == (name != "good")
    capsys.readouterr()
    assert main(["compare", "a", "b"]) == 0
    assert f"protocol: {CHANGED}" in capsys.readouterr().out
    assert main(["compare", "good", "a"]) == 2

from __future__ import annotations

from pathlib import Path

import pytest

from carecontact.cli import main
from tests.trials.test_freeze import frozen_file


def test_list_and_show(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["protocol", "list"]) == 0
    assert "bathing-v1-draft         draft" in capsys.readouterr().out
    assert main(["protocol", "show"]) == 0
    out = capsys.readouterr().out
    assert out.startswith("# bathing-v1-draft, sha256 ")
    assert "# paper-mapping, abdomen: " in out
    assert "[physics]" in out


def test_a_draft_does_not_verify(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["protocol", "verify"]) == 1
    assert "has no lock: a draft" in capsys.readouterr().out


def test_lock_verify_and_drift(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = frozen_file(tmp_path)
    assert main(["protocol", "lock", str(path)]) == 0
    assert main(["protocol", "verify", str(path)]) == 0
    assert "is here what was frozen" in capsys.readouterr().out
    assert main(["protocol", "lock", str(path)]) == 2
    assert "is there already" in capsys.readouterr().err
    path.write_text(path.read_text().replace("time_limit_s = 30.0", "time_limit_s = 31.0"))
    assert main(["protocol", "verify", str(path)]) == 1
    assert "protocol sha256: locked" in capsys.readouterr().out
    run = ["run", "--policy", "zero-action", "--protocol", str(path), "--out", str(tmp_path / "run")]
    assert main(run) == 2
    assert "mine-v1 drifted from its lock" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [("frozen = true", "frozen = false", "say frozen = true first"), ("mine-v1", "bathing-v1-draft", "own")],
)
def test_what_cannot_be_locked(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], old: str, new: str, told: str
) -> None:
    path = frozen_file(tmp_path)
    path.write_text(path.read_text().replace(old, new))
    assert main(["protocol", "lock", str(path)]) == 2
    assert told in capsys.readouterr().err


def test_a_shipped_protocol_is_not_locked_in_place(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["protocol", "lock", "bathing-v1-draft"]) == 2
    assert "copy its file" in capsys.readouterr().err

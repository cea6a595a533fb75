from __future__ import annotations

from functools import cache
from pathlib import Path

import pytest

from carecontact.cli import main
from carecontact.protocol.load import load_protocol, protocol_file
from carecontact.protocol.protocol import Protocol
from carecontact.protocol.sections import Variation
from carecontact.runs import identity
from tests.protocol.held import ship_frozen
from tests.runs.test_identity import frozen_file

WORLD_SUMS = identity.world_sums


@pytest.fixture(autouse=True)
def compiled_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """The compiled world hangs on neither name nor variation, and a verification compiles one a region."""
    monkeypatch.setattr(identity, "world_sums", lambda protocol, region: sums_of(region, world_of(protocol)))


def world_of(protocol: Protocol) -> str:
    same = {"id": "any", "description": "", "variation": Variation(), "phases": load_protocol("bathing-v3").phases}
    return protocol.model_copy(update=same).model_dump_json()


@cache
def sums_of(region: str, protocol: str) -> dict[str, float]:
    return WORLD_SUMS(Protocol.model_validate_json(protocol), region)


def test_list_and_show(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["protocol", "list"]) == 0
    assert "bathing-v3               frozen: " in capsys.readouterr().out
    assert main(["protocol", "show"]) == 0
    out = capsys.readouterr().out
    assert out.startswith("# bathing-wide-v2 L0, sha256 ")
    assert "# frozen, bathing-wide-v2.L0.lock.json" in out
    assert "# human-published, abdomen: " in out
    assert "[physics]" in out


@pytest.fixture
def held(monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory) -> Protocol:
    return ship_frozen(monkeypatch, tmp_path_factory.mktemp("shipped"), worlds=True)


def test_a_shipped_protocol_with_its_lock_is_shown_and_verified(
    held: Protocol, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["protocol", "show", held.id]) == 0
    assert f"# frozen, {held.id}.lock.json" in capsys.readouterr().out
    assert main(["protocol", "verify", held.id]) == 0
    assert capsys.readouterr().out == f"{held.id}: equals its lock\n"


@pytest.mark.parametrize(
    ("frozen", "message"),
    [
        ("true", "mine-v1 has frozen = true but no lock: mine.lock.json is missing; "),
        ("false", "mine-v1 has no lock: a draft, which may change with every release\n"),
    ],
)
def test_a_file_without_a_lock_does_not_verify(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], frozen: str, message: str
) -> None:
    path = frozen_file(tmp_path)
    path.write_text(path.read_text().replace("frozen = true", f"frozen = {frozen}"))
    assert main(["protocol", "verify", str(path)]) == 1
    assert capsys.readouterr().out.startswith(message)


@pytest.mark.parametrize("frozen", ["true", "false"])
def test_a_file_with_a_shipped_id_is_verified_by_the_shipped_lock(
    tmp_path: Path, held: Protocol, capsys: pytest.CaptureFixture[str], frozen: str
) -> None:
    path = tmp_path / "drift.toml"
    text = protocol_file(held.id).read_text(encoding="utf-8")
    path.write_text(text.replace("on_n = 0.5", "on_n = 0.4").replace("frozen = true", f"frozen = {frozen}"))
    assert main(["protocol", "verify", str(path)]) == 1
    out = capsys.readouterr().out
    assert out.startswith(f"{path} has the id of a shipped protocol, so it must equal the lock of that protocol\n")
    assert "contact.on_n: locked 0.5, here 0.4" in out
    assert out.endswith(f"{held.id}: differs from its lock\n")
    path.write_text(text)
    assert main(["protocol", "verify", str(path)]) == 0
    assert capsys.readouterr().out.endswith(f"{held.id}: equals its lock\n")


def test_lock_verify_and_drift(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = frozen_file(tmp_path)
    assert main(["protocol", "lock", str(path)]) == 0
    assert main(["protocol", "verify", str(path)]) == 0
    assert "equals its lock" in capsys.readouterr().out
    assert main(["protocol", "lock", str(path)]) == 2
    assert "exists already" in capsys.readouterr().err
    path.write_text(path.read_text().replace("time_limit_s = 30.0", "time_limit_s = 31.0"))
    assert main(["protocol", "verify", str(path)]) == 1
    assert "protocol sha256: locked" in capsys.readouterr().out
    run = ["run", "--policy", "zero-action", "--protocol", str(path), "--out", str(tmp_path / "run")]
    assert main(run) == 2
    assert "mine-v1 differs from its lock" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [("frozen = true", "frozen = false", "set frozen = true"), ("mine-v1", "bathing-v3", "own")],
)
def test_what_cannot_be_locked(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], old: str, new: str, message: str
) -> None:
    path = frozen_file(tmp_path)
    path.write_text(path.read_text().replace(old, new))
    assert main(["protocol", "lock", str(path)]) == 2
    assert message in capsys.readouterr().err


def test_a_shipped_protocol_is_not_locked_in_place(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["protocol", "lock", "bathing-v3"]) == 2
    assert "copy its file" in capsys.readouterr().err

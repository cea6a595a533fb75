"""The secret of a run: made, committed to, used by every trial, revealed and verified."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import pytest

from carecontact.audit import salt as audit_salt
from carecontact.cli import main
from carecontact.recording import read_header
from tests.cli.test_run_and_demo import fake

__all__ = ["fake"]
RUN = ["run", "--policy", "hover", "--tasks", "T1", "--seeds", "0-1", "--salt-file", "salt.txt"]


@pytest.fixture
def made(fake: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> str:
    """The hash that `salt make` prints. Recordings of the fake workers hold nothing that was drawn."""
    fake.setattr(audit_salt, "drawn_again", lambda recording, salt: [])
    assert main(["salt", "make", "salt.txt"]) == 0
    return capsys.readouterr().out.split()[-1]


def manifest(run: str) -> dict[str, object]:
    return json.loads(Path(run, "manifest.json").read_text())


def test_a_salt_is_a_private_file_whose_bytes_have_the_printed_hash(made: str) -> None:
    content = Path("salt.txt").read_bytes()
    assert hashlib.sha256(content).hexdigest() == made
    assert len(content) == 64
    assert Path("salt.txt").stat().st_mode & 0o777 == 0o600
    assert main(["salt", "make", "salt.txt"]) == 2
    assert Path("salt.txt").read_bytes() == content


def test_a_run_states_the_hash_and_never_the_salt_until_it_is_revealed(
    made: str, capsys: pytest.CaptureFixture[str]
) -> None:
    salt = Path("salt.txt").read_text()
    assert main([*RUN, "--out", "r"]) == 0
    assert f"salted: sha256 {made}" in capsys.readouterr().out
    assert manifest("r")["salt_sha256"] == made
    assert read_header(Path("r/T1-s000.h5")).spec.salt_sha256 == made
    assert [path.name for path in Path("r").iterdir() if path.is_file() and salt.encode() in path.read_bytes()] == []
    assert {row["world"]["salt"] for row in json.loads(Path("r/results.json").read_text())["trials"]} == {made}
    assert f'<th scope="row">Salt sha256</th><td class="hash">{made}</td>' in Path("r/report.html").read_text()

    assert main(["salt", "verify", "r"]) == 2
    assert "the salt is not revealed yet" in capsys.readouterr().err
    before = Path("r/T1-s000.h5").read_bytes()
    assert main(["salt", "reveal", "r", "--salt-file", "salt.txt"]) == 0
    assert manifest("r")["salt"] == salt
    assert Path("r/T1-s000.h5").read_bytes() == before
    assert main([*RUN, "--out", "r"]) == 0, "and the run still goes on"
    assert manifest("r")["salt"] == salt
    capsys.readouterr()
    assert main(["salt", "verify", "r"]) == 0
    assert f"verified: sha256 {made}, 2 recordings" in capsys.readouterr().out


def test_another_salt_is_neither_revealed_nor_verified(made: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*RUN, "--out", "r"]) == 0
    assert main(["salt", "make", "other.txt"]) == 0
    assert main(["salt", "reveal", "r", "--salt-file", "other.txt"]) == 2
    assert f"whose sha256 is {made}" in capsys.readouterr().err
    # Somebody edits the manifest by hand.
    content = manifest("r") | {"salt": Path("other.txt").read_text()}
    Path("r/manifest.json").write_text(json.dumps(content))
    assert main(["salt", "verify", "r"]) == 1
    content["salt_sha256"] = hashlib.sha256(Path("other.txt").read_bytes()).hexdigest()
    Path("r/manifest.json").write_text(json.dumps(content))
    capsys.readouterr()
    assert main(["salt", "verify", "r"]) == 1
    assert f"T1-s001.h5: it names the salt {made}" in capsys.readouterr().out


@pytest.mark.parametrize("salt", [[], ["--salt-file", "other.txt"]])
def test_a_folder_has_one_salt(made: str, salt: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*RUN, "--out", "r"]) == 0
    assert main(["salt", "make", "other.txt"]) == 0
    assert main([*RUN[:-2], *salt, "--out", "r"]) == 2
    assert "started with another --salt-file" in capsys.readouterr().err


def test_parts_share_a_salt_and_their_merge_keeps_it(made: str, capsys: pytest.CaptureFixture[str]) -> None:
    for k in (1, 2):
        assert main([*RUN, "--shard", f"{k}/2", "--out", f"part-{k}"]) == 0
    assert main(["salt", "reveal", "part-2", "--salt-file", "salt.txt"]) == 0
    assert main(["merge", "merged", "part-1", "part-2"]) == 0
    assert (manifest("merged")["salt_sha256"], manifest("merged")["salt"]) == (made, Path("salt.txt").read_text())
    assert main(["salt", "verify", "merged"]) == 0
    assert main([*RUN[:-2], "--shard", "2/2", "--out", "unsalted"]) == 0
    capsys.readouterr()
    assert main(["merge", "mixed", "part-1", "unsalted"]) == 2
    assert "different salts" in capsys.readouterr().err
    assert main(["compare", "part-2", "unsalted", "--allow-incomplete"]) == 2
    told = capsys.readouterr().err
    assert f"salt {made[:12]}" in told
    assert "run both with the same --salt-file, or both without" in told


@pytest.mark.parametrize(
    ("command", "told"),
    [
        (["salt", "verify", "nothing"], "is not a run"),
        (["salt", "make", "new.txt", "--salt-file", "salt.txt"], "`salt reveal RUN` needs it, and only that"),
        (["salt", "reveal", "nothing"], "`salt reveal RUN` needs it"),
        ([*RUN[:-1], "none.txt", "--out", "r"], "--salt-file none.txt: cannot be read"),
        ([*RUN[:-1], "short.txt", "--out", "r"], "expected 64 hexadecimal digits"),
        ([*RUN, "--noise-salt", "0a" * 16, "--out", "r"], "--salt-file decides the sensor noise too"),
    ],
)
def test_mistakes(made: str, command: list[str], told: str, capsys: pytest.CaptureFixture[str]) -> None:
    Path("short.txt").write_text("12ab\n")
    assert main(command) == 2
    assert told in capsys.readouterr().err
    assert not Path("nothing").exists()

"""The quick audit, as anyone would run it, and what ends it."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import pytest

from carecontact.audit import salt as audit_salt
from carecontact.cli import main
from carecontact.policies.registry import POLICIES, role_of
from carecontact.recording import read_header
from tests.audit.conftest import send_a_privileged_key

AUDITED = [name for name in POLICIES if role_of(name) != "privileged"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "audited", "privileged"),
    [
        (["--policy", "state-machine"], ["state-machine"], []),
        pytest.param([], AUDITED, ["oracle"], id="every registered policy"),
    ],
)
def test_nothing_leaks_on_the_hardest_level(
    options: list[str], audited: list[str], privileged: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    hardest = ["--protocol", "bathing-wide-v2", "--level", "L3", "--seed", "5", *options]
    assert main(["verify", "leaks", "--quick", *hardest, "-o", str(tmp_path / "audit")]) == 0
    printed = capsys.readouterr().out
    assert printed.startswith(f"bathing-wide-v2 L3, seed 5, man-adult-light, quick: {', '.join(audited)}\n")
    rows = [line.split()[:2] for line in printed.splitlines() if line.startswith(("pass ", "FAIL "))]
    assert rows == [["pass", name] for name in ("re-derivation", "readings", "frozen", "canary", "handshake", "schema")]
    record = json.loads((tmp_path / "audit" / "audit.json").read_text())
    assert record["schema"] == "carecontact-audit-1"
    assert record["passed"] is True
    assert (record["protocol"]["id"], record["protocol"]["level"], record["protocol"]["seed"]) == (
        "bathing-wide-v2 L3", "L3", 5,
    )  # fmt: skip
    assert (record["policies"], record["privileged"]) == (audited, privileged)
    counts = {part["part"]: part["counts"] for part in record["parts"]}
    assert counts["schema"] == {"trials": len(audited), "messages": len(audited)}
    assert "cards: 1, " in printed
    # The press that is seen, at every third action, and the blind one at every action.
    # How many of them are in contact depends on the laws of the tissue, which may change while the protocol is a draft.
    assert 8 <= counts["re-derivation"]["observations in contact"] <= 3 + 9
    # One of each policy, and those of both presses until a while after their first contact.
    assert counts["readings"]["looks"] == counts["readings"]["looks timed"] > len(audited) + 16
    assert counts["readings"]["images drawn again"] > 20 + len(audited)
    assert counts["canary"]["observations before contact"] >= 2
    assert counts["frozen frames"]["fields of the world scrambled"] > 100


def test_a_leak_ends_with_status_1_and_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    send_a_privileged_key(monkeypatch)
    assert main(["verify", "leaks", "--quick", "--policy", "zero-action", "--tasks", "T1,T3", "-o", str(tmp_path)]) == 1
    printed = capsys.readouterr().out
    # Both tasks are on the forearm, which is pressed once, with a card that names the policy once.
    assert printed.count("running two presses on the forearm with the card of zero-action\n") == 1
    assert printed.count("running two presses") == 1
    assert printed.splitlines()[-1] == f"FAILED: {tmp_path / 'audit.json'}"
    record = json.loads((tmp_path / "audit.json").read_text())
    assert record["passed"] is False
    assert [row["task"] for row in record["trials"]] == ["T1", "T3"]
    named = {part["part"]: {f["place"] for f in part["findings"]} for part in record["parts"]}
    assert named["schema"] == named["canary"] == {"observation.contact_force"}
    assert "zero-action: observation.contact_force: the trial failed" in printed


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--policy", "no-such"], "no policy named 'no-such'; valid: feint-and-wait, hover"),
        (["--policy", "oracle"], "oracle: this policy is privileged"),
        (["--policy", "hover", "hover"], "hover is named twice"),
        (["--seed", "54"], "--seed: 54 is not a seed of bathing-wide-v2"),
        (["--tasks", "T8"], "'T8' is not a task of bathing-wide-v2 L2"),
        (["--protocol", "none"], "no protocol named 'none'"),
        (["-o", __file__], "this is a file; name a folder"),
        (["--policy", "nowhere:Policy"], "does not start"),
    ],
)
def test_what_cannot_be_audited_is_named(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["verify", "leaks", "--quick", *arguments]) == 2
    printed = capsys.readouterr()
    assert message in printed.err
    assert printed.out == ""


# The secret of a run: made, committed to, used by every trial, revealed and verified.

RUN = [
    "run", "--policy", "hover", "--protocol", "bathing-v3", "--tasks", "T1", "--seeds", "0-1",
    "--salt-file", "salt.txt",
]  # fmt: skip


@pytest.fixture
def made(fake: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> str:
    """The hash that `protocol salt make` prints. Recordings of the fake workers hold nothing that was drawn."""
    fake.setattr(audit_salt, "drawn_again", lambda recording, salt: [])
    assert main(["protocol", "salt", "make", "salt.txt"]) == 0
    return capsys.readouterr().out.split()[-1]


def manifest(run: str) -> dict[str, object]:
    return json.loads(Path(run, "manifest.json").read_text())


def test_a_salt_is_a_private_file_whose_bytes_have_the_printed_hash(made: str) -> None:
    content = Path("salt.txt").read_bytes()
    assert hashlib.sha256(content).hexdigest() == made
    assert len(content) == 64
    assert Path("salt.txt").stat().st_mode & 0o777 == 0o600
    assert main(["protocol", "salt", "make", "salt.txt"]) == 2
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

    assert main(["protocol", "salt", "verify", "r"]) == 2
    assert "the salt is not revealed yet" in capsys.readouterr().err
    before = Path("r/T1-s000.h5").read_bytes()
    assert main(["protocol", "salt", "reveal", "r", "--salt-file", "salt.txt"]) == 0
    assert manifest("r")["salt"] == salt
    assert Path("r/T1-s000.h5").read_bytes() == before
    assert main([*RUN, "--out", "r"]) == 0, "and the run still goes on"
    assert manifest("r")["salt"] == salt
    capsys.readouterr()
    assert main(["protocol", "salt", "verify", "r"]) == 0
    assert f"verified: sha256 {made}, 2 recordings" in capsys.readouterr().out


def test_another_salt_is_neither_revealed_nor_verified(made: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*RUN, "--out", "r"]) == 0
    assert main(["protocol", "salt", "make", "other.txt"]) == 0
    assert main(["protocol", "salt", "reveal", "r", "--salt-file", "other.txt"]) == 2
    assert f"whose sha256 is {made}" in capsys.readouterr().err
    # Somebody edits the manifest by hand.
    content = manifest("r") | {"salt": Path("other.txt").read_text()}
    Path("r/manifest.json").write_text(json.dumps(content))
    assert main(["protocol", "salt", "verify", "r"]) == 1
    content["salt_sha256"] = hashlib.sha256(Path("other.txt").read_bytes()).hexdigest()
    Path("r/manifest.json").write_text(json.dumps(content))
    capsys.readouterr()
    assert main(["protocol", "salt", "verify", "r"]) == 1
    assert f"T1-s001.h5: it names the salt {made}" in capsys.readouterr().out


@pytest.mark.parametrize("salt", [[], ["--salt-file", "other.txt"]])
def test_a_folder_has_one_salt(made: str, salt: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*RUN, "--out", "r"]) == 0
    assert main(["protocol", "salt", "make", "other.txt"]) == 0
    assert main([*RUN[:-2], *salt, "--out", "r"]) == 2
    assert "started with another --salt-file" in capsys.readouterr().err


def test_parts_share_a_salt_and_their_merge_keeps_it(made: str, capsys: pytest.CaptureFixture[str]) -> None:
    for k in (1, 2):
        assert main([*RUN, "--shard", f"{k}/2", "--out", f"part-{k}"]) == 0
    assert main(["protocol", "salt", "reveal", "part-2", "--salt-file", "salt.txt"]) == 0
    assert main(["merge", "merged", "part-1", "part-2"]) == 0
    assert (manifest("merged")["salt_sha256"], manifest("merged")["salt"]) == (made, Path("salt.txt").read_text())
    assert main(["protocol", "salt", "verify", "merged"]) == 0
    assert main([*RUN[:-2], "--shard", "2/2", "--out", "unsalted"]) == 0
    capsys.readouterr()
    assert main(["merge", "mixed", "part-1", "unsalted"]) == 2
    assert "different salts" in capsys.readouterr().err
    assert main(["compare", "part-2", "unsalted", "--allow-incomplete"]) == 2
    printed = capsys.readouterr().err
    assert f"salt {made[:12]}" in printed
    assert "run both with the same --salt-file, or both without" in printed


@pytest.mark.parametrize(
    ("command", "message"),
    [
        (["protocol", "salt", "verify", "nothing"], "is not a run"),
        (["protocol", "salt", "make", "new.txt", "--salt-file", "salt.txt"], "RUN` needs it, and only that"),
        (["protocol", "salt", "reveal", "nothing"], "`protocol salt reveal RUN` needs it"),
        ([*RUN[:-1], "none.txt", "--out", "r"], "--salt-file none.txt: cannot be read"),
        ([*RUN[:-1], "short.txt", "--out", "r"], "expected 64 hexadecimal digits"),
        ([*RUN, "--noise-salt", "0a" * 16, "--out", "r"], "--salt-file decides the sensor noise too"),
    ],
)
def test_mistakes(made: str, command: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    Path("short.txt").write_text("12ab\n")
    assert main(command) == 2
    assert message in capsys.readouterr().err
    assert not Path("nothing").exists()

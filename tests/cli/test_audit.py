"""The quick audit of every registered policy, as anybody would run it, and what ends it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from carecontact.cli import main
from carecontact.policies.registry import POLICIES, role_of
from tests.audit.conftest import send_a_privileged_key

AUDITED = [name for name in POLICIES if role_of(name) != "privileged"]


def test_nothing_leaks_to_any_registered_policy_on_the_hardest_level(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    hardest = ["--protocol", "bathing-wide-v2-draft", "--level", "L3", "--seed", "5"]
    assert main(["audit", "--quick", *hardest, "-o", str(tmp_path / "audit")]) == 0
    printed = capsys.readouterr().out
    assert printed.startswith(f"bathing-wide-v2-draft L3, seed 5, man-adult-light, quick: {', '.join(AUDITED)}\n")
    rows = [line.split()[:2] for line in printed.splitlines() if line.startswith(("pass ", "FAIL "))]
    assert rows == [["pass", name] for name in ("re-derivation", "readings", "frozen", "canary", "handshake", "schema")]
    said = json.loads((tmp_path / "audit" / "audit.json").read_text())
    assert said["schema"] == "carecontact-audit-1"
    assert said["passed"] is True
    assert (said["protocol"]["id"], said["protocol"]["level"], said["protocol"]["seed"]) == (
        "bathing-wide-v2-draft L3", "L3", 5,
    )  # fmt: skip
    assert (said["policies"], said["privileged"]) == (AUDITED, ["oracle"])
    counts = {part["part"]: part["counts"] for part in said["parts"]}
    assert counts["schema"] == {"trials": len(AUDITED), "messages": len(AUDITED)}
    assert "1 card, " in printed
    # The press that is seen, at every third action, and the blind one at every action.
    # How many of them are in contact depends on the laws of the tissue, which may change while the protocol is a draft.
    assert 8 <= counts["re-derivation"]["observations in contact"] <= 3 + 9
    # One of each policy, and those of both presses until a while after their first contact.
    assert counts["readings"]["looks"] == counts["readings"]["looks timed"] > len(AUDITED) + 16
    assert counts["readings"]["images drawn again"] > 30
    assert counts["canary"]["observations before contact"] >= 2
    assert counts["frozen frames"]["fields of the world scrambled"] > 100


def test_a_leak_ends_with_status_1_and_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    send_a_privileged_key(monkeypatch)
    assert main(["audit", "--quick", "--policy", "zero-action", "--tasks", "T1,T3", "-o", str(tmp_path)]) == 1
    printed = capsys.readouterr().out
    # Both tasks are on the forearm, which is pressed once, with a card that names the policy once.
    assert printed.count("running two presses on the forearm with the card of zero-action\n") == 1
    assert printed.count("running two presses") == 1
    assert printed.splitlines()[-1] == f"FAILED: {tmp_path / 'audit.json'}"
    said = json.loads((tmp_path / "audit.json").read_text())
    assert said["passed"] is False
    assert [row["task"] for row in said["trials"]] == ["T1", "T3"]
    named = {part["part"]: {f["place"] for f in part["findings"]} for part in said["parts"]}
    assert named["schema"] == named["canary"] == {"observation.contact_force"}
    assert "zero-action: observation.contact_force: the trial failed" in printed


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["--policy", "no-such"], "no policy named 'no-such'; valid: feint-and-wait, hover"),
        (["--policy", "oracle"], "oracle: this policy is privileged"),
        (["--policy", "hover", "hover"], "hover is named twice"),
        (["--seed", "20"], "--seed: 20 is not a seed of bathing-v3-draft; valid: 0-19"),
        (["--tasks", "T8"], "'T8' is not a task of bathing-v3-draft"),
        (["--protocol", "none"], "no protocol named 'none'"),
        (["-o", __file__], "this is a file; name a folder"),
        (["--policy", "nowhere:Policy"], "does not start"),
    ],
)
def test_what_cannot_be_audited_is_told(arguments: list[str], told: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["audit", "--quick", *arguments]) == 2
    said = capsys.readouterr()
    assert told in said.err
    assert said.out == ""

"""What makes two commands the same run."""

from __future__ import annotations

import hashlib
from pathlib import Path

import pytest

from carecontact.contract.policy import PolicyCard
from carecontact.contract.policy_ref import PolicyRef
from carecontact.errors import ConfigError
from carecontact.policies.registry import POLICIES
from carecontact.runs.identity import identity_of, policy_package, policy_source
from carecontact.runs.manifest import survey, write_manifest
from tests.installed import look_again, write_package
from tests.scoring.synthetic import touch

SPEC = touch(seed=0).header.spec


def test_a_replaced_checkpoint_is_another_run(tmp_path: Path) -> None:
    weights, out = tmp_path / "w.pt", tmp_path / "run"
    out.mkdir()
    weights.write_bytes(b"step 1")
    spec = SPEC.model_copy(update={"policy_arguments": {"checkpoint": str(weights), "chunk": "8"}})
    write_manifest([spec], out=out, identity=identity_of(spec, search_path=[]), purpose="run")
    survey([spec], out=out, retry_failed=False, identity=identity_of(spec, search_path=[]))
    weights.write_bytes(b"step 2")
    with pytest.raises(ConfigError, match=r"the content of .*w\.pt \(policy argument checkpoint\) changed"):
        survey([spec], out=out, retry_failed=False, identity=identity_of(spec, search_path=[]))


def test_a_registered_policy_of_another_package_counts_by_its_version_and_source(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    row = "from carecontact.policies.registry import PolicyRow\nROW = PolicyRow(target='tapper:Tapper', description='')"
    write_package(
        tmp_path, "tapping", version="2.0", files={"tapper": "class Tapper: ...", "tapper_row": row},
        points={"policies": {"tapper": "tapper_row:ROW"}},
    )  # fmt: skip
    monkeypatch.syspath_prepend(tmp_path)
    look_again(monkeypatch, POLICIES)
    ref = PolicyRef.parse("tapper")
    assert policy_source(ref, search_path=[]) == tmp_path / "tapper.py"
    assert policy_package(ref) == {"tapping": "2.0"}
    identity = identity_of(SPEC.model_copy(update={"policy": "tapper"}), search_path=[])
    assert identity.policy_sha256 == hashlib.sha256(b"class Tapper: ...").hexdigest()
    assert identity.versions["tapping"] == "2.0"


def test_another_card_behind_an_address_is_another_run(tmp_path: Path) -> None:
    spec = SPEC.model_copy(update={"policy": "ws://192.0.2.7:8765"})
    first, second = (
        identity_of(spec, search_path=[], card=PolicyCard(name=f"mine step {step}")) for step in (1000, 2000)
    )
    write_manifest([spec], out=tmp_path, identity=first, purpose="run")
    survey([spec], out=tmp_path, retry_failed=False, identity=first)
    with pytest.raises(ConfigError, match=r"card of ws://192.0.2.7:8765 changed .*name was 'mine step 1"):
        survey([spec], out=tmp_path, retry_failed=False, identity=second)
    local = identity_of(SPEC.model_copy(update={"policy": "hover"}), search_path=[], card=PolicyCard(name="hover"))
    assert local.card is None


@pytest.mark.parametrize("name", ["hover", "ws://192.0.2.7:8765"])
def test_no_source_is_hashed_of_a_shipped_policy_or_one_on_another_host(name: str) -> None:
    ref = PolicyRef.parse(name)
    assert policy_source(ref, search_path=[]) is None
    assert policy_package(ref) == {}

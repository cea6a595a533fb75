"""What makes two commands the same run."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from carecontact.errors import ConfigError
from carecontact.interface.policy import PolicyCard, PolicyRef
from carecontact.policies.registry import POLICIES
from carecontact.protocol.load import load_protocol, protocol_file
from carecontact.protocol.lock import Lock, lock_path, read_lock, write_lock
from carecontact.protocol.protocol import Protocol
from carecontact.recording import Recording, write_recording
from carecontact.running.lost import harness_error_recording
from carecontact.runs import identity
from carecontact.runs.identity import (
    check_frozen,
    drift,
    fingerprint_of,
    fingerprints,
    identity_of,
    lock_of,
    make_lock,
    policy_package,
    policy_source,
)
from carecontact.runs.manifest import read_manifest, survey, write_manifest
from tests.installed import look_again, write_package
from tests.protocol.held import frozen_text, ship_frozen
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
        tmp_path,
        "tapping",
        version="2.0",
        files={"tapper": "class Tapper: ...", "tapper_row": row},
        points={"policies": {"tapper": "tapper_row:ROW"}},
    )
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


@pytest.mark.parametrize(("before", "now"), [("rules-v1", None), (None, "rules-v1"), ("live:m-1", "live:m-2")])
def test_another_language_backend_needs_another_folder(tmp_path: Path, before: str | None, now: str | None) -> None:
    first, second = (identity_of(SPEC, search_path=[], language=language) for language in (before, now))
    write_manifest([SPEC], out=tmp_path, identity=first, purpose="run")
    manifest = read_manifest(tmp_path)
    assert manifest is not None
    assert manifest.identity.language == before
    assert not survey([SPEC], out=tmp_path, retry_failed=False, identity=first).redo
    with pytest.raises(ConfigError, match=r"was started with language backend .*: use another folder"):
        survey([SPEC], out=tmp_path, retry_failed=False, identity=second)


def test_a_recording_with_another_language_backend_is_refused_without_a_manifest(tmp_path: Path) -> None:
    failed = harness_error_recording(SPEC, kind="x", message="x")
    header = failed.header.model_copy(update={"card": {"language_backend": "rules-v1"}, "ended": "done"})
    write_recording(Recording(header=header, arrays=failed.arrays), tmp_path / "T1-s000.h5")
    rules, live = (identity_of(SPEC, search_path=[], language=language) for language in ("rules-v1", "live:m-1"))
    assert survey([SPEC], out=tmp_path, retry_failed=False, identity=rules).keep
    with pytest.raises(ConfigError, match="recorded with language backend rules-v1"):
        survey([SPEC], out=tmp_path, retry_failed=False, identity=live)


@pytest.mark.parametrize("name", ["hover", "ws://192.0.2.7:8765"])
def test_no_source_is_hashed_of_a_shipped_policy_or_one_on_another_host(name: str) -> None:
    ref = PolicyRef.parse(name)
    assert policy_source(ref, search_path=[]) is None
    assert policy_package(ref) == {}


def test_only_what_is_a_file_or_folder_has_one(tmp_path: Path) -> None:
    (tmp_path / "w.pt").write_bytes(b"weights")
    given = {"checkpoint": str(tmp_path / "w.pt"), "folder": str(tmp_path), "steps": "3", "empty": "", "odd": "a\0b"}
    assert set(fingerprints(given)) == {"checkpoint", "folder"}


@pytest.mark.parametrize("whole", [1 << 26, 0], ids=["read whole", "sampled"])
@pytest.mark.parametrize("kind", ["file", "folder"])
def test_it_follows_the_content_and_not_the_place(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str, whole: int
) -> None:
    monkeypatch.setattr(identity, "WHOLE_BYTES", whole)
    monkeypatch.setattr(identity, "SAMPLE_BYTES", 4)
    content, changed = bytes(range(256)) * 4, bytes(range(256)) * 3 + bytes(range(255, -1, -1))
    found = []
    for name, data in (("a", content), ("b", content), ("c", changed), ("d", content[:-1])):
        (tmp_path / name).mkdir()
        (tmp_path / name / "w.pt").write_bytes(data)
        found.append(fingerprint_of(tmp_path / name if kind == "folder" else tmp_path / name / "w.pt"))
    assert found[0] == found[1]
    assert len(set(found)) == 3


def test_a_folder_of_very_many_files_has_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(identity, "MAX_FILES", 2)
    for number in range(3):
        (tmp_path / str(number)).touch()
    assert fingerprint_of(tmp_path) is None


# A lock holds what a protocol's numbers rest on; whatever of it is another here is named.


@pytest.fixture(scope="module")
def here() -> Lock:
    return make_lock(load_protocol("bathing-v3"))


def frozen_file(folder: Path, *, extra: str = "") -> Path:
    path = folder / "mine.toml"
    path.write_text(frozen_text("mine-v1") + extra)
    return path


@pytest.fixture
def locked(tmp_path: Path) -> tuple[str, Protocol]:
    """A frozen protocol of the user's with a lock; without worlds, which take seconds."""
    path = frozen_file(tmp_path)
    protocol = load_protocol(str(path))
    write_lock(make_lock(protocol, worlds=False), lock_path(str(path)))
    return str(path), protocol


@pytest.mark.usefixtures("worlds_from_scratch")
def test_nothing_drifts_here_and_compiling_again_gives_the_same_sums(here: Lock) -> None:
    assert drift(here, here) == []
    region = "forearm"
    assert identity.world_sums(load_protocol("bathing-v3"), region) == here.worlds[region]
    assert here.worlds["forearm"] != here.worlds["abdomen"]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"protocol_sha256": "0" * 64}, "protocol sha256: locked 000000000000"),
        ({"embodiment": "other-arm"}, "embodiment: locked other-arm"),
        ({"versions": {"mujoco": "3.0.0", "ai-edge-litert": "2.3.0"}}, "version of mujoco: locked 3.0.0"),
        ({"assets": {}}, "asset bodies/man-adult.npz: locked none"),
        ({"assets": {}}, "asset kernel/c: locked none"),
        ({"fields": {}}, "physics: locked null"),
    ],
)
def test_each_difference_is_named(here: Lock, change: dict[str, object], message: str) -> None:
    assert any(line.startswith(message) for line in drift(here.model_copy(update=change), here))


def test_rounding_of_a_world_is_no_drift_and_a_millionth_of_mass_is(here: Lock) -> None:
    def scaled(factor: float) -> Lock:
        forearm = {**here.worlds["forearm"], "body_mass": factor * here.worlds["forearm"]["body_mass"]}
        return here.model_copy(update={"worlds": {**here.worlds, "forearm": forearm}})

    assert drift(scaled(1 + 1e-9), here) == []
    assert drift(scaled(1 + 1e-5), here) == ["world (forearm): body_mass"]


def test_what_is_locked_runs_and_what_drifted_is_refused_or_says_so(locked: tuple[str, Protocol]) -> None:
    path, protocol = locked
    assert check_frozen(path, protocol, unfrozen=False) == protocol
    gates = protocol.gates.model_copy(update={"region_share": 0.7})
    drifted = protocol.model_copy(update={"gates": gates})
    with pytest.raises(
        ConfigError, match=r"mine-v1 differs .*protocol sha256.*gates.region_share: locked 0.8, here 0.7.*--unfrozen"
    ):
        check_frozen(path, drifted, unfrozen=False)
    accepted = check_frozen(path, drifted, unfrozen=True)
    assert "differences from its lock (protocol sha256" in accepted.title
    assert accepted.sha256 != drifted.sha256


def test_a_draft_needs_no_lock_and_a_frozen_file_does(tmp_path: Path) -> None:
    path = str(frozen_file(tmp_path))
    draft = load_protocol(path).model_copy(update={"frozen": False})
    assert check_frozen(path, draft, unfrozen=False) == draft
    with pytest.raises(ConfigError, match=r"says frozen = true but has no lock: mine\.lock\.json is missing"):
        check_frozen(path, load_protocol(path), unfrozen=True)


@pytest.mark.parametrize("text", ["", "{}", '{"id": 3}', "[1, 2]"])
def test_a_damaged_lock_is_named(tmp_path: Path, text: str) -> None:
    path = str(frozen_file(tmp_path))
    lock_path(path).write_text(text)
    with pytest.raises(ConfigError, match=r"mine\.lock\.json: not a lock"):
        read_lock(path)


# -- what is shipped -------------------------------------------------------------------------------------------------


@pytest.fixture
def shipped(monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory) -> Protocol:
    return ship_frozen(monkeypatch, tmp_path_factory.mktemp("shipped"))


def test_a_shipped_protocol_with_its_lock_runs_here(shipped: Protocol) -> None:
    assert shipped.frozen
    assert check_frozen(shipped.id, shipped, unfrozen=False) == shipped


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda lock: {"versions": lock.versions | {"mujoco": "4.0.1"}}, "version of mujoco: locked 4.0.0, here 4.0.1"),
        (lambda lock: {"versions": lock.versions | {"ai-edge-litert": "not installed"}}, "here not installed"),
        (lambda lock: {"assets": lock.assets | {"panda/panda.npz": "0" * 64}}, "here 000000000000"),
        (lambda lock: {"assets": {}}, "asset bodies/man-adult.skin.png: locked"),
    ],
)
def test_a_shipped_protocol_does_not_run_where_something_else_is_installed(
    shipped: Protocol, monkeypatch: pytest.MonkeyPatch, change: Callable[[Lock], dict[str, Any]], message: str
) -> None:
    here = make_lock(shipped, worlds=False)
    monkeypatch.setattr(identity, "make_lock", lambda protocol, worlds: here.model_copy(update=change(here)))
    with pytest.raises(ConfigError, match=f"{shipped.id} differs from its lock .*{re.escape(message)}.*--unfrozen"):
        check_frozen(shipped.id, shipped, unfrozen=False)
    assert check_frozen(shipped.id, shipped, unfrozen=True).overrides.keys() == {"lock"}


def test_the_line_that_installs_the_locked_versions_is_given(
    shipped: Protocol, monkeypatch: pytest.MonkeyPatch
) -> None:
    here = make_lock(shipped, worlds=False)
    other = here.model_copy(update={"versions": here.versions | {"mujoco": "4.0.1"}})
    monkeypatch.setattr(identity, "make_lock", lambda protocol, worlds: other)
    line = rf"python -m pip install mujoco=={re.escape(here.versions['mujoco'])}, or run with --unfrozen"
    with pytest.raises(ConfigError, match=line):
        check_frozen(shipped.id, shipped, unfrozen=False)


@pytest.mark.parametrize("frozen", ["frozen = true", "frozen = false"])
def test_a_file_with_a_shipped_id_is_held_to_the_shipped_lock(tmp_path: Path, shipped: Protocol, frozen: str) -> None:
    text = protocol_file(shipped.id).read_text()
    path = tmp_path / "mine.toml"
    path.write_text(text)
    assert check_frozen(str(path), load_protocol(str(path)), unfrozen=False) == shipped
    path.write_text(
        text.replace("frozen = true", frozen).replace("translational_n_m = 400.0", "translational_n_m = 500.0")
    )
    message = r"impedance\.translational_n_m: locked 400\.0, here 500\.0.*mine\.toml an id of its own"
    with pytest.raises(ConfigError, match=message):
        check_frozen(str(path), load_protocol(str(path)), unfrozen=False)


def test_a_level_has_a_lock_of_its_own(tmp_path: Path) -> None:
    path = str(tmp_path / "mine.toml")
    text = protocol_file("bathing-wide-v2").read_text().replace("frozen = false", "frozen = true")
    Path(path).write_text(text.replace('id = "bathing-wide-v2"', 'id = "mine-v1"'))
    for level in ("L0", "L3"):
        write_lock(make_lock(load_protocol(path, level=level), worlds=False), lock_path(path, level=level))
    found = lock_of(path, load_protocol(path, level="L3"))
    assert found == read_lock(path, level="L3") != read_lock(path, level="L0")


def test_a_lock_holds_a_world_of_every_body_and_region() -> None:
    varied = load_protocol("bathing-wide-v2", level="L3")
    worlds = identity.worlds_of(varied)
    assert [rules.person.body for rules, _ in worlds.values()] == list(varied.variation.bodies)
    assert {region for _, region in worlds.values()} == set(varied.regions)
    assert identity.worlds_of(load_protocol("bathing-v3")) == {
        region: (load_protocol("bathing-v3"), region) for region in varied.regions
    }

"""A lock holds what a protocol's numbers rest on; whatever of it is another here is named."""

from __future__ import annotations

from pathlib import Path

import pytest

from carecontact.contract.protocol import Protocol
from carecontact.errors import ConfigError
from carecontact.protocols import load_protocol, protocol_file
from carecontact.protocols.lock import Lock, lock_path, read_lock, write_lock
from carecontact.trials import freeze
from carecontact.trials.freeze import check_frozen, drift, make_lock


@pytest.fixture(scope="module")
def here() -> Lock:
    return make_lock(load_protocol())


def frozen_file(folder: Path, *, extra: str = "") -> Path:
    text = protocol_file("bathing-v1-draft").read_text()
    text = text.replace('id = "bathing-v1-draft"', 'id = "mine-v1"').replace("frozen = false", "frozen = true")
    path = folder / "mine.toml"
    path.write_text(text + extra)
    return path


@pytest.fixture
def locked(tmp_path: Path) -> tuple[str, Protocol]:
    """A frozen protocol of the user's with a lock; without worlds, which take seconds."""
    path = frozen_file(tmp_path)
    protocol = load_protocol(str(path))
    write_lock(make_lock(protocol, worlds=False), lock_path(str(path)))
    return str(path), protocol


def test_nothing_drifts_here_and_compiling_again_gives_the_same_sums(here: Lock) -> None:
    assert drift(here, here) == []
    region = "forearm"
    assert freeze.world_sums(load_protocol(), region) == here.worlds[region]
    assert here.worlds["forearm"] != here.worlds["abdomen"]


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"protocol_sha256": "0" * 64}, "protocol sha256: locked 000000000000"),
        ({"embodiment": "other-arm"}, "embodiment: locked other-arm"),
        ({"metrics": ["C1@0"]}, "metric C1@0: locked, not here"),
        ({"versions": {"mujoco": "3.0.0", "mediapipe": "0.10.21"}}, "version of mujoco: locked 3.0.0"),
        ({"assets": {}}, "asset bodies/man-adult.npz: locked none"),
    ],
)
def test_each_difference_is_named(here: Lock, change: dict[str, object], told: str) -> None:
    assert any(line.startswith(told) for line in drift(here.model_copy(update=change), here))


def test_rounding_of_a_world_is_no_drift_and_a_millionth_of_mass_is(here: Lock) -> None:
    def scaled(factor: float) -> Lock:
        forearm = {**here.worlds["forearm"], "body_mass": factor * here.worlds["forearm"]["body_mass"]}
        return here.model_copy(update={"worlds": {**here.worlds, "forearm": forearm}})

    assert drift(scaled(1 + 1e-9), here) == []
    assert drift(scaled(1 + 1e-5), here) == ["world with the forearm as target: body_mass"]


def test_a_new_metric_is_no_drift(here: Lock) -> None:
    assert drift(here.model_copy(update={"metrics": here.metrics[:-1]}), here) == []


def test_what_is_locked_runs_and_what_drifted_is_refused_or_says_so(locked: tuple[str, Protocol]) -> None:
    path, protocol = locked
    assert check_frozen(path, protocol, unfrozen=False) == protocol
    drifted = protocol.model_copy(update={"description": "another"})
    with pytest.raises(ConfigError, match=r"mine-v1 drifted from its lock .*protocol sha256.*--unfrozen"):
        check_frozen(path, drifted, unfrozen=False)
    accepted = check_frozen(path, drifted, unfrozen=True)
    assert "drift from its lock (protocol sha256" in accepted.title
    assert accepted.sha256 != drifted.sha256


def test_a_draft_needs_no_lock_and_a_frozen_file_does(tmp_path: Path) -> None:
    assert check_frozen("bathing-v1-draft", load_protocol(), unfrozen=False) == load_protocol()
    assert read_lock("bathing-v1-draft") is None
    path = str(frozen_file(tmp_path))
    with pytest.raises(ConfigError, match=r"says frozen = true but has no lock: mine\.lock\.json is missing"):
        check_frozen(path, load_protocol(path), unfrozen=True)


@pytest.mark.parametrize("text", ["", "{}", '{"id": 3}', "[1, 2]"])
def test_a_damaged_lock_is_named(tmp_path: Path, text: str) -> None:
    path = str(frozen_file(tmp_path))
    lock_path(path).write_text(text)
    with pytest.raises(ConfigError, match=r"mine\.lock\.json: not a lock"):
        read_lock(path)

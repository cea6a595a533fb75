from __future__ import annotations

from pathlib import Path

import pytest

from carecontact.contract.protocol import Protocol
from carecontact.protocols import FAST_DT_S, load_protocol, overridden
from carecontact.protocols.frozen_state import drifted_sha256, frozen_state
from tests.protocols.held import HELD, ship_frozen


@pytest.fixture
def held(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Protocol:
    return ship_frozen(monkeypatch, tmp_path)


def softened(protocol: Protocol) -> Protocol:
    """The same id and title with a pain limit ten times as high."""
    pain = {name: 10 * value for name, value in protocol.limits.f_pain_n.items()}
    return protocol.model_copy(update={"limits": protocol.limits.model_copy(update={"f_pain_n": pain})})


def test_what_is_locked_is_frozen_and_announced_overrides_do_not_change_that(held: Protocol) -> None:
    protocol = held
    assert frozen_state(protocol) == "frozen"
    changes = {"impedance.translational_n_m": 200.0, "physics.dt_s": FAST_DT_S, "gates.push.force_n": 4.0}
    assert frozen_state(overridden(protocol, changes)) == "frozen"
    assert drifted_sha256(protocol.id, protocol.sha256) is None


def test_a_changed_protocol_under_the_same_id_is_named(held: Protocol) -> None:
    changed = softened(held)
    assert frozen_state(changed).startswith(f"not the frozen {HELD}: sha256 {changed.sha256[:12]}, locked ")
    hidden = softened(overridden(held, {"impedance.translational_n_m": 200.0}))
    assert frozen_state(hidden).startswith(f"not the frozen {HELD}")
    assert f"not the frozen {HELD}" in (drifted_sha256(changed.id, changed.sha256) or "")


def test_drift_that_a_run_announced(held: Protocol) -> None:
    drifted = held.model_copy(update={"overrides": {"lock": "asset x: locked a, here b"}})
    assert frozen_state(drifted) == f"not the frozen {HELD}: asset x: locked a, here b"


def test_files_of_ones_own() -> None:
    own = load_protocol("bathing-v3-draft").model_copy(update={"id": "mine-v1", "frozen": True})
    assert frozen_state(own).startswith("not verified as frozen: ")
    assert frozen_state(own.model_copy(update={"frozen": False})) == "draft"


def test_a_draft_is_one_and_an_earlier_recording_is_not_verified() -> None:
    draft = load_protocol("bathing-droid-draft")
    assert frozen_state(draft) == "draft"
    assert frozen_state(softened(draft)) == "draft"
    earlier = draft.model_copy(update={"id": "bathing-v2", "frozen": True})
    assert frozen_state(earlier).startswith("not verified as frozen: ")
    assert drifted_sha256("bathing-v2", earlier.sha256) is None

"""Dotted overrides: what they replace, how they are recorded, and how they are taken back."""

from __future__ import annotations

import pytest

from carecontact.contract.protocol import Protocol
from carecontact.errors import ConfigError, UnknownNameError
from carecontact.protocols import FAST_DT_S, load_protocol, overridden, without_overrides
from carecontact.protocols.tissue_sets import load_tissue_set

PROTOCOL = load_protocol()
FOUR = {
    "person.body": "woman-old-light", "person.tissue_set": "human-published", "physics.dt_s": "0.004",
    "impedance.translational_n_m": "200",
}  # fmt: skip
SAM = {"vision.segmenter": "grounded-sam", "vision.weights_sha256": "ab" * 32}


def test_an_override_is_another_hash_and_title_but_the_same_id() -> None:
    other = overridden(PROTOCOL, {"person.body": "woman-old-light"})
    assert (other.id, other.person.body) == (PROTOCOL.id, "woman-old-light")
    assert other.overrides == {"person.body": "woman-old-light"}
    assert other.title == f"{PROTOCOL.id} with body woman-old-light"
    assert other.sha256 != PROTOCOL.sha256
    assert PROTOCOL.title == PROTOCOL.id
    # The round trip that a worker gets changes nothing.
    assert Protocol.model_validate(other.model_dump(mode="json")) == other
    edited = PROTOCOL.model_copy(update={"person": PROTOCOL.person.model_copy(update={"body": "woman-old-light"})})
    assert edited.sha256 != other.sha256, "a changed file is not the same as an announced override"


def test_a_field_that_has_the_value_already_is_no_override() -> None:
    assert overridden(PROTOCOL, {}) == PROTOCOL
    own = {
        "person.body": PROTOCOL.person.body, "person.tissue_set": PROTOCOL.person.tissue_set, "physics.dt_s": "2e-3",
        "impedance.translational_n_m": PROTOCOL.impedance.translational_n_m, "vision.segmenter": "mediapipe",
        "vision.weights_sha256": "",
    }  # fmt: skip
    assert overridden(PROTOCOL, own) == PROTOCOL


def test_spelling_and_title() -> None:
    other = overridden(PROTOCOL, FOUR)
    assert other.overrides == FOUR
    rows = load_tissue_set("human-published").tissue
    assert (other.person.tissue, other.physics.dt_s, other.impedance.translational_n_m) == (rows, 0.004, 200)
    assert other.title == (
        f"{PROTOCOL.id} with stiffness 200 N/m and body woman-old-light and tissue human-published and time step "
        "0.004 s"
    )
    # Values may be typed as well as text.
    assert other == overridden(PROTOCOL, FOUR | {"physics.dt_s": FAST_DT_S, "impedance.translational_n_m": 200})


def test_overrides_are_taken_back_and_what_was_changed_besides_shows() -> None:
    other = overridden(PROTOCOL, FOUR | SAM | {"tasks.T1.prompt": "touch it", "gates.push.force_n": "4"})
    assert without_overrides(other, PROTOCOL) == PROTOCOL
    easier = other.model_copy(update={"gates": other.gates.model_copy(update={"region_share": 0.1})})
    assert without_overrides(easier, PROTOCOL) != PROTOCOL
    unknown = other.model_copy(update={"overrides": {**other.overrides, "physics.gone": "1"}})
    assert without_overrides(unknown, PROTOCOL) == PROTOCOL, "a path that the original does not have changes nothing"


def test_any_field_can_be_replaced_and_stands_in_the_title() -> None:
    other = overridden(
        PROTOCOL,
        {"gates.push.force_n": "4", "tasks.T6.prompt": "touch the belly", "randomization.seeds": "[0, 1]",
         "limits.f_pain_n.abdomen": "50", "person.tissue.forearm.friction": "0.7"},
    )  # fmt: skip
    assert other.gates.of("push").force_n == 4.0
    assert other.task("T6").prompt == "touch the belly"
    assert other.randomization.seeds == [0, 1]
    assert other.f_pain("abdomen") == 50.0
    assert other.person.tissue["forearm"].friction == 0.7
    assert other.overrides["gates.push.force_n"] == "4"
    assert other.overrides["randomization.seeds"] == "[0, 1]"
    assert all(path in other.title for path in other.overrides)


def test_a_segmenter_is_recorded_with_its_weights() -> None:
    other = overridden(PROTOCOL, SAM)
    assert other.overrides == {"vision.segmenter": "grounded-sam abababababab"}
    assert other.title == f"{PROTOCOL.id} with segmenter grounded-sam abababababab"
    assert Protocol.model_validate(other.model_dump(mode="json")) == other
    assert without_overrides(other, PROTOCOL) == PROTOCOL
    weights = overridden(other, {"vision.weights_sha256": "cd" * 32})
    assert weights.overrides == {"vision.segmenter": "grounded-sam cdcdcdcdcdcd"}


def test_one_override_keeps_another() -> None:
    first = overridden(PROTOCOL, {"person.body": "woman-old-light"})
    both = {"person.body": "woman-old-light", "physics.dt_s": "0.004"}
    assert overridden(first, {"physics.dt_s": "0.004"}) == overridden(PROTOCOL, both)


def test_the_more_exact_path_counts_in_any_order() -> None:
    changes = {"person.tissue.forearm.friction": "0.7", "person.tissue_set": "human-published"}
    for order in (changes, dict(reversed(changes.items()))):
        other = overridden(PROTOCOL, order)
        assert other.person.tissue["forearm"].friction == 0.7
        assert other.overrides == {"person.tissue.forearm.friction": "0.7", "person.tissue_set": "human-published"}
    later = overridden(other, {"person.tissue_set": "manikin-like"})
    assert later.overrides == {"person.tissue_set": "manikin-like"}, "the whole set replaces the row"


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"person.bdy": "x"}, r"person\.bdy: no field 'bdy' in person .*; valid: body, tissue_set, tissue"),
        ({"physic.dt_s": "1"}, r"no field 'physic' in a protocol .*; valid: physics, phases"),
        ({"tasks.T9.prompt": "x"}, r"no field 'T9' in tasks; valid: T1, T2"),
        ({"gates.hold.force_n": "1"}, r"no field 'hold' in gates; valid: .*touch, push, scrub"),
        ({"physics.dt_s.ms": "1"}, r"physics\.dt_s is a single value"),
        ({"id": "x"}, r"no field 'id' in a protocol"),
        ({"physics.dt_s": "fast"}, r"physics\.dt_s: expected a number \(got fast\)"),
        ({"physics.dt_s": "nan"}, r"physics\.dt_s: .*finite"),
        ({"physics.dt_s": "0.003"}, r"physics\.target_period_s: expected a whole number of dt_s"),
        ({"tasks.T1.action": "hit"}, r"tasks\.T1\.action: .*'hit'.*push, scrub.*touch"),
        ({"vision.segmenter": "grounded-sam"}, r"vision\.weights_sha256: expected the sha256"),
    ],
)
def test_a_wrong_path_or_value_names_what_is_valid(changes: dict[str, str], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        overridden(PROTOCOL, changes)


def test_a_tissue_set_without_a_row_that_the_protocol_needs_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = load_tissue_set("human-published")
    part = whole.model_copy(update={"tissue": {"forearm": whole.tissue["forearm"]}})
    monkeypatch.setattr("carecontact.protocols.overrides.load_tissue_set", lambda *names: part)
    with pytest.raises(
        ConfigError, match="tissue set mine: no row for upper_arm, abdomen, which bathing-v3-draft needs"
    ):
        overridden(PROTOCOL, {"person.tissue_set": "mine"})


def test_a_tissue_set_that_does_not_exist_lists_those_that_do() -> None:
    with pytest.raises(UnknownNameError, match=r"no tissue set named 'skin'; valid: .*human-published"):
        overridden(PROTOCOL, {"person.tissue_set": "skin"})


@pytest.mark.parametrize("value", ["99", "1001"])
def test_a_stiffness_outside_the_protocols_bounds_is_refused(value: str) -> None:
    with pytest.raises(ConfigError, match=rf"impedance\.translational_n_m: expected 100 to 1000, .* got {value}"):
        overridden(PROTOCOL, {"impedance.translational_n_m": value})

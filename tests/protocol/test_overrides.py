"""Dotted overrides: what they replace, how they are recorded, and how they are taken back."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError

from carecontact.errors import ConfigError, UnknownNameError
from carecontact.protocol.load import load_protocol
from carecontact.protocol.overrides import (
    FAST_DT_S,
    SKIN_STATES,
    friction_changes,
    load_tissue_set,
    overridden,
    shipped_tissue_sets,
    without_overrides,
)
from carecontact.protocol.person import Tissue
from carecontact.protocol.protocol import Protocol, protocol_title

PROTOCOL = load_protocol("bathing-v3")
FOUR = {
    "person.body": "woman-old-light",
    "person.tissue_set": "human-published",
    "physics.dt_s": "0.004",
    "impedance.translational_n_m": "200",
}
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
        "person.body": PROTOCOL.person.body,
        "person.tissue_set": PROTOCOL.person.tissue_set,
        "physics.dt_s": "2e-3",
        "impedance.translational_n_m": PROTOCOL.impedance.translational_n_m,
        "vision.segmenter": "mediapipe",
        "vision.weights_sha256": "",
    }
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
        {
            "gates.push.force_n": "4",
            "tasks.T6.prompt": "touch the belly",
            "randomization.seeds": "[0, 1]",
            "limits.f_pain_n.abdomen": "50",
            "person.tissue.forearm.friction": "0.7",
        },
    )
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
    monkeypatch.setattr("carecontact.protocol.overrides.load_tissue_set", lambda *names: part)
    with pytest.raises(ConfigError, match="tissue set mine: no row for upper_arm, abdomen, which bathing-v3 needs"):
        overridden(PROTOCOL, {"person.tissue_set": "mine"})


def test_a_tissue_set_that_does_not_exist_lists_those_that_do() -> None:
    with pytest.raises(UnknownNameError, match=r"no tissue set named 'skin'; valid: .*human-published"):
        overridden(PROTOCOL, {"person.tissue_set": "skin"})


@pytest.mark.parametrize("value", ["99", "1001"])
def test_a_stiffness_outside_the_protocols_bounds_is_refused(value: str) -> None:
    with pytest.raises(ConfigError, match=rf"impedance\.translational_n_m: expected 100 to 1000, .* got {value}"):
        overridden(PROTOCOL, {"impedance.translational_n_m": value})


RULES = load_protocol("bathing-v3")


@pytest.mark.parametrize(("friction", "value"), [(k, s.coefficient) for k, s in SKIN_STATES.items()] + [("0.8", 0.8)])
def test_every_soft_region_gets_the_coefficient(friction: str, value: float) -> None:
    changed = overridden(RULES, {"person.tissue_set": "human-published", **friction_changes(RULES, friction)})
    assert {region: changed.person.tissue[region].friction for region in RULES.soft_regions} == dict.fromkeys(
        RULES.soft_regions, value
    )
    assert changed.person.tissue_set == "human-published"


def test_states_have_sources_and_lie_in_their_order() -> None:
    assert SKIN_STATES["soapy"].coefficient < SKIN_STATES["dry"].coefficient < SKIN_STATES["wet"].coefficient
    assert all(state.source for state in SKIN_STATES.values())


def test_a_title_says_one_friction_once() -> None:
    assert overridden(RULES, friction_changes(RULES, "wet")).title == "bathing-v3 with friction 1"
    two = {"person.tissue.forearm.friction": "1", "person.tissue.abdomen.friction": "0.8"}
    assert protocol_title("x", two) == (
        "x with person.tissue.abdomen.friction 0.8 and person.tissue.forearm.friction 1"
    )


@pytest.mark.parametrize("friction", ["slimy", "", "wet "])
def test_another_word_is_refused(friction: str) -> None:
    with pytest.raises(ConfigError, match=r"--friction .*: expected dry, wet, soapy or a coefficient, such as 0\.8"):
        friction_changes(RULES, friction)


# Named tissue sets: what ships, what a user's own file must say, and how a protocol takes one.

PROTOCOL_TISSUE_SETS = load_protocol("bathing-v3")
ROW = """
[tissue.forearm]
a_n_m3 = 1.5e6
b_n_m4 = 0.0
c_n_m5 = 1e8
coupling_length_m = 0.0
membrane_n_m = 0.0
damping_ns_m3 = 2e4
areal_mass_kg_m2 = 12.0
contact_n_m3 = 5e7
spacing_m = 0.005
coarse_spacing_m = 0.020
thickness_m = 0.018
measured_depth_m = 0.006
friction = 0.5
source = "calibrated to trials"
"""


def written(folder: Path, text: str) -> str:
    path = folder / "mine.toml"
    path.write_text(text)
    return str(path)


def test_three_sets_ship_and_the_protocol_has_the_papers() -> None:
    assert shipped_tissue_sets() == ["human-published", "manikin-like", "paper-mapping"]
    assert PROTOCOL_TISSUE_SETS.person.tissue_set == "paper-mapping"
    assert PROTOCOL_TISSUE_SETS.person.tissue == load_tissue_set("paper-mapping").tissue


@pytest.mark.parametrize("name", shipped_tissue_sets())
def test_every_row_tells_its_source_and_measured_range(name: str) -> None:
    rows = load_tissue_set(name).tissue
    assert set(rows) == {"forearm", "upper_arm", "abdomen"}
    for row in rows.values():
        assert len(row.source) > 40
        assert 0.002 < row.measured_depth_m < row.thickness_m
        assert row.spacing_m == 0.005
        assert row.contact_n_m3 == 5e7, "within 2.3e7 to 6.7e7"
        # Three times critical: 2 sqrt(a m) is critical per area.
        assert row.damping_ns_m3 == pytest.approx(6 * (row.a_n_m3 * row.areal_mass_kg_m2) ** 0.5, rel=0.03)


def test_the_papers_upper_arm_reuses_the_forearms_law_and_published_data_give_another() -> None:
    paper, published = (load_tissue_set(name).tissue for name in ("paper-mapping", "human-published"))

    def law(row: object) -> list[float]:
        return [getattr(row, name) for name in ("a_n_m3", "b_n_m4", "c_n_m5", "damping_ns_m3")]

    assert law(paper["upper_arm"]) == law(paper["forearm"])
    assert law(published["upper_arm"]) != law(paper["upper_arm"])
    assert published["forearm"] == paper["forearm"]


def test_hash_is_of_the_rows_alone(tmp_path: Path) -> None:
    first = load_tissue_set(written(tmp_path, f'id = "a"\ndescription = "x"\nbase = "paper-mapping"\n{ROW}'))
    again = load_tissue_set(written(tmp_path, f'# note\nid = "b"\ndescription = "y"\nbase = "paper-mapping"\n{ROW}'))
    other = load_tissue_set(
        written(tmp_path, f'id = "a"\ndescription = "x"\nbase = "paper-mapping"\n{ROW}'.replace("1.5e6", "1.6e6"))
    )
    assert first.sha256 == again.sha256 != other.sha256
    assert first.tissue["abdomen"] == PROTOCOL_TISSUE_SETS.person.tissue["abdomen"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (f'id = "mine"\ndescription = "x"\n{ROW}', r"no row for upper_arm, abdomen; add base"),
        (f'id = "mine"\ndescription = "x"\nbase = "none"\n{ROW}', r"base 'none'; valid: human-published"),
        (f'id = "manikin-like"\ndescription = "x"\nbase = "paper-mapping"\n{ROW}', r"is a shipped set's"),
        (ROW, r"id: missing; give it a value"),
        ('id = "mine', r"not TOML"),
        (f'id = "mine"\ndescription = "x"\n{ROW}'.replace("2e4", "-2e4"), r"tissue\.forearm\.damping_ns_m3: .*got -2"),
        (f'id = "mine"\ndescription = "x"\n{ROW}'.replace("1e8", "nan"), r"tissue\.forearm\.c_n_m5: .*finite"),
        ('id = "mine"\ndescription = "x"\n[tissue.knee]\na_n_m3 = 1', r"tissue\.knee"),
    ],
)
def test_a_wrong_file_is_reported_with_place(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        load_tissue_set(written(tmp_path, text))


def test_unknown_and_missing_sets_are_named(tmp_path: Path) -> None:
    with pytest.raises(UnknownNameError, match=r"no tissue set named 'skin'; valid: FILE.toml, human-published"):
        load_tissue_set("skin")
    with pytest.raises(ConfigError, match="No such file"):
        load_tissue_set(str(tmp_path / "none.toml"))


def test_the_documents_symbol_table_has_the_shipped_forearm() -> None:
    row = load_tissue_set("paper-mapping").tissue["forearm"]
    lines = (Path(__file__).parents[2] / "docs" / "evidence" / "tissue.md").read_text().splitlines()
    cells = {line.split("|")[2].strip(): line.split("|")[4].strip() for line in lines if line.count("|") == 6}
    shown = {name.strip("` "): value for names, value in cells.items() for name in names.split(",")}
    assert float(shown["a_n_m3"]) == row.a_n_m3
    assert [float(value) for value in cells["`b_n_m4`, `c_n_m5`"].split(",")] == [row.b_n_m4, row.c_n_m5]
    assert float(shown["damping_ns_m3"]) == row.damping_ns_m3
    assert float(shown["membrane_n_m"].split()[0]) == row.membrane_n_m


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"measured_depth_m": 0.19}, "no press went into the bone"),
        ({"friction": 50.0}, "less than or equal to 2"),
        ({"source": ""}, "at least 1 character"),
        ({"b_n_m4": -5e8, "c_n_m5": 1e10}, "makes the law soften under load"),
        ({"damping_growth_ns_m4": -1.0}, "greater than or equal to 0"),
    ],
)
def test_a_row_that_no_skin_has_is_refused(change: dict[str, Any], message: str) -> None:
    row = load_tissue_set("paper-mapping").tissue["forearm"]
    with pytest.raises(ValidationError, match=message):
        Tissue.model_validate({**row.model_dump(), **change})

"""The protocol's schema: strict about what is in a file, and a hash over all of it."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from copy import deepcopy
from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError

from carecontact.errors import ConfigError
from carecontact.protocol.load import load_protocol
from carecontact.protocol.person import Alive, Breathing, Repositioning
from carecontact.protocol.protocol import Protocol, TrialSpec

PROTOCOL = load_protocol("bathing-v3")
DUMP = PROTOCOL.model_dump(mode="json")
FieldPath = tuple[str | int, ...]


def leaves(node: Any, path: FieldPath = ()) -> Iterator[tuple[FieldPath, Any]]:
    children = node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else None
    if children is None:
        yield path, node
        return
    for key, child in children:
        yield from leaves(child, (*path, key))


def sections(node: Any, path: FieldPath = ()) -> Iterator[FieldPath]:
    """Places whose keys the schema fixes; the free-key tables hold only numbers or lists of names."""
    if isinstance(node, dict):
        if not set(path) & {"neighbourhood", "f_pain_n"}:
            yield path
        for key, child in node.items():
            yield from sections(child, (*path, key))
    elif isinstance(node, list):
        for index, child in enumerate(node):
            yield from sections(child, (*path, index))


def changed(path: FieldPath, value: Any) -> dict[str, Any]:
    out = deepcopy(DUMP)
    node: Any = out
    for key in path[:-1]:
        node = node[key]
    node[path[-1]] = value
    return out


def test_every_number_and_text_counts_in_the_hash() -> None:
    seen = {PROTOCOL.sha256}
    count = 0
    for path, value in leaves(DUMP):
        if value is None:
            continue
        if isinstance(value, bool):
            other: Any = not value
        elif isinstance(value, int | float):
            other = value + 1 if isinstance(value, int) else value * 1.01 + 1e-3
        else:
            other = value + "x"
        try:
            protocol = Protocol.model_validate(changed(path, other))
        except ValidationError:
            continue  # a literal, or a share beyond one
        seen.add(protocol.sha256)
        count += 1
    assert count > 150
    assert len(seen) == count + 1


def test_hash_ignores_the_order_of_keys() -> None:
    backwards = {key: DUMP[key] for key in reversed(DUMP)}
    backwards["cameras"] = {key: DUMP["cameras"][key] for key in reversed(DUMP["cameras"])}
    assert Protocol.model_validate(backwards).sha256 == PROTOCOL.sha256


def test_hash_ignores_how_a_number_is_written() -> None:
    assert isinstance(DUMP["impedance"]["translational_n_m"], float)
    whole = changed(("impedance", "translational_n_m"), int(DUMP["impedance"]["translational_n_m"]))
    assert Protocol.model_validate(whole).sha256 == PROTOCOL.sha256


@pytest.mark.parametrize("path", list(sections(DUMP)), ids=lambda p: ".".join(map(str, p)) or "top")
def test_no_section_takes_a_field_it_does_not_know(path: FieldPath) -> None:
    with pytest.raises(ValidationError) as caught:
        Protocol.model_validate(changed((*path, "spam"), 1))
    assert all(error["loc"][: len(path)] == path for error in caught.value.errors())


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf")])
def test_no_number_is_infinite_or_undefined(value: float) -> None:
    accepted = []
    for path, old in leaves(DUMP):
        if isinstance(old, float):
            try:
                Protocol.model_validate(changed(path, value))
            except ValidationError:
                continue
            accepted.append(path)
    assert accepted == []


@pytest.mark.parametrize(
    ("path", "value"),
    [
        (("physics", "dt_s"), 0.0),
        (("physics", "dt_s"), -0.002),
        (("physics", "integrator"), "euler"),
        (("gates", "scrub", "on_share"), 1.01),
        (("gates", "region_share"), -0.1),
        (("contact", "version"), "contact-v2"),
        (("gates", "set"), "gates-v9"),
        (("tasks", 0, "action"), "hit"),
        (("tasks", 0, "region"), "head"),
        (("scene", "tool"), "glove"),
        (("cameras", "overhead", "mount"), "ceiling"),
    ],
)
def test_impossible_values_are_refused(path: FieldPath, value: Any) -> None:
    with pytest.raises(ValidationError) as caught:
        Protocol.model_validate(changed(path, value))
    assert {error["loc"][: len(path)] for error in caught.value.errors()} == {path}


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        (("tasks", 0, "id"), "T2", "tasks: expected at least one, each with an id of its own"),
        (("contact", "neighbourhood"), {}, "contact.neighbourhood.forearm: missing, and task T1 needs it"),
        (("person", "tissue"), {}, "person.tissue: expected exactly .*'upper_arm'"),
        (("cameras",), {"wrist": DUMP["cameras"]["wrist"]}, "cameras: expected overhead, bedside, exterior and wrist"),
        (("randomization", "seeds"), [1, 1], "randomization.seeds: expected distinct whole numbers"),
        (("limits", "f_pain_n"), {"forearm": 0.0}, "limits.f_pain_n: expected at least one segment, each above 0 N"),
        (("contact", "off_n"), 0.5, "contact.off_n: expected less than on_n"),
        (("randomization", "comfort_arm_deg"), [60.0, 45.0], "randomization.comfort_arm_deg: expected low below high"),
        (("scene", "board_low_m"), [9.0, 9.0], "scene.board: expected low below high"),
        (("phases", "settle_min_s"), 99.0, "phases.settle: expected low below high"),
        (("impedance", "rotational_nm_rad"), 1e6, "impedance.rotational_nm_rad: expected 5 to 50, its bounds"),
    ],
)
def test_fields_that_contradict_each_other_are_named(path: FieldPath, value: Any, message: str) -> None:
    with pytest.raises(ValidationError, match=message):
        Protocol.model_validate(changed(path, value))


def test_a_parked_posture_has_an_angle_for_each_joint_of_the_robot() -> None:
    with pytest.raises(ValidationError, match=r"parked_joint_rad: expected 7 angles .*, got 6"):
        Protocol.model_validate(changed(("scene", "parked_joint_rad"), [0.0] * 6))


def test_protocols_are_frozen() -> None:
    with pytest.raises(ValidationError):
        PROTOCOL.gates.push.force_n = 1.0


def test_pain_limit_of_a_segment_ignores_the_side_and_falls_back_to_the_strictest() -> None:
    limits = PROTOCOL.limits.model_copy(update={"f_pain_n": {"forearm": 100.0, "abdomen": 60.0, "thorax": 80.0}})
    protocol = PROTOCOL.model_copy(update={"limits": limits})
    segments = ("right_forearm", "left_forearm", "abdomen", "thorax", "head", "right_hand")
    assert [protocol.f_pain(s) for s in segments] == [100, 100, 60, 80, 60, 60]


def test_task_by_id() -> None:
    assert PROTOCOL.task("T5").name == "Scrub upper arm"
    with pytest.raises(KeyError):
        PROTOCOL.task("T8")


@pytest.mark.parametrize("name", ["../T1", "a/b", "", ".", "T1\n", "-s", "T 1", "T1.h5", "x" * 65, "Ä"])
def test_ids_that_name_files_name_them_in_the_runs_folder(name: str) -> None:
    content = load_protocol("bathing-v3").model_dump()
    for place in (content, content["tasks"][0]):
        held, place["id"] = place["id"], name
        with pytest.raises(ValidationError, match="id"):
            Protocol.model_validate(content)
        place["id"] = held
    assert Protocol.model_validate(content) == load_protocol("bathing-v3")


@pytest.mark.parametrize(
    "vision",
    [{"segmenter": "grounded-sam"}, {"weights_sha256": "ab" * 32}, {"segmenter": "sam"}, {"weights_sha256": "x"}],
)
def test_a_segmenter_and_its_weights_belong_together(vision: dict[str, str]) -> None:
    with pytest.raises(ValidationError, match="vision"):
        Protocol.model_validate(PROTOCOL.model_dump() | {"vision": vision})


@pytest.mark.parametrize(
    "varied", [{"appearance": "varied-v1"}, {"light": "varied-v1"}, {"depth_noise": "structured-light-v1"},
               {"encoder_noise_rad": 0.003}, {"place_along_m": 0.01}, {"place_across_m": 0.01}, {"place_yaw_deg": 1.0},
               {"calibration_m": 0.003}, {"calibration_deg": 0.2}]
)  # fmt: skip
def test_variation_that_is_on_is_part_of_the_protocol(varied: dict[str, object]) -> None:
    protocol = load_protocol("bathing-v3")
    other = Protocol.model_validate({**protocol.model_dump(mode="json"), "variation": varied})
    assert other.sha256 != protocol.sha256
    assert Protocol.model_validate_json(other.model_dump_json()) == other


@pytest.mark.parametrize(
    "wrong",
    [
        {"appearance": "other"},
        {"encoder_noise_rad": -1},
        {"colour": "red"},
        {"place_along_m": 40.0},
        {"place_across_m": -0.01},
        {"place_yaw_deg": 90.0},
        {"calibration_m": 3.0},
        {"calibration_deg": -0.2},
    ],
)
def test_unknown_variations_are_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(ValidationError, match="variation"):
        Protocol.model_validate({**load_protocol("bathing-v3").model_dump(mode="json"), "variation": wrong})


# The table ``person.alive`` of a protocol.


def loaded(folder: Path, alive: str) -> Protocol:
    file = folder / "mine.toml"
    file.write_text(f'base = "bathing-v3"\nid = "mine"\ndescription = "x"\nfrozen = false\n{alive}')
    return load_protocol(str(file))


def test_what_the_person_does_is_part_of_the_hash() -> None:
    protocol = load_protocol("bathing-v3")
    assert protocol.person.alive == Alive()
    moves = protocol.person.model_copy(update={"alive": Alive(manner="holds")})
    assert protocol.model_copy(update={"person": moves}).sha256 != protocol.sha256


def test_an_empty_table_takes_the_published_values(tmp_path: Path) -> None:
    alive = loaded(tmp_path, "[person.alive.breathing]\n[person.alive.repositioning]\n").person.alive
    assert (alive.breathing, alive.repositioning) == (Breathing(), Repositioning())
    assert alive.withdrawal is None
    assert alive.uses_the_arm


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ("[person.alive.breathing]\nfrequency_hz = [0.3, 0.2]", r"breathing\.frequency_hz: expected \[low, high\] Hz"),
        (
            "[person.alive.breathing]\nabdomen_m = [5, 15]",
            r"breathing\.abdomen_m: expected .* 0 to 0\.03, got \[5, 15\]",
        ),
        ("[person.alive.repositioning]\nper_minute = 0", r"repositioning\.per_minute: expected more than 0"),
        ("[person.alive.withdrawal]\nwrist_m = 8", r"withdrawal\.wrist_m: expected at most 0\.15"),
        ('[person.alive]\nmanner = "fights"', r"alive\.manner: expected 'passive', 'helps' or 'holds'"),
        (
            "[person.alive.breathing]\nrate = 1",
            r"no such field in the table person\.alive\.breathing.*valid: frequency_hz",
        ),
    ],
)
def test_a_wrong_value_is_reported_with_what_would_be_valid(tmp_path: Path, table: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        loaded(tmp_path, table)


SPEC = TrialSpec(protocol=load_protocol("bathing-v3"), task_id="T3", seed=7, policy="hover")


def test_ids_sort_like_seeds_and_differ_in_task_and_seed() -> None:
    assert SPEC.trial_id == "T3-s007"
    specs = [SPEC.model_copy(update={"seed": s, "task_id": t}) for t in ("T1", "T2") for s in (0, 2, 9, 10, 19, 100)]
    ids = [spec.trial_id for spec in specs]
    assert ids == sorted(ids)
    assert len(set(ids)) == len(ids)


def test_header_round_trip_keeps_the_protocols_hash() -> None:
    back = TrialSpec.model_validate_json(SPEC.model_dump_json())
    assert back == SPEC
    assert back.protocol.sha256 == SPEC.protocol.sha256


def test_a_noise_salt_is_spelt() -> None:
    salted = SPEC.model_copy(update={"noise_salt": "ab"})
    assert TrialSpec.model_validate_json(salted.model_dump_json()).noise_salt == "ab"


def test_a_sealed_trial_names_the_hash_of_its_salt_and_not_the_salt() -> None:
    salt = "5a" * 32
    salted = SPEC.model_copy(update={"salt": salt})
    assert TrialSpec.model_validate_json(salted.model_dump_json()).salt == salt
    assert salt not in repr(salted)
    assert salt not in salted.sealed.model_dump_json()
    assert salted.sealed.salt_sha256 == hashlib.sha256(salt.encode()).hexdigest() == salted.sealed.commitment
    assert SPEC.sealed == SPEC


def test_policy_arguments_are_spelt() -> None:
    given = {"policy_arguments": {"steps": "3"}, "policy_environment": ("TOKEN",)}
    back = TrialSpec.model_validate_json(SPEC.model_copy(update=given).model_dump_json())
    assert (back.policy_arguments, back.policy_environment) == ({"steps": "3"}, ("TOKEN",))
    assert back != SPEC


def test_a_spec_is_frozen_and_closed() -> None:
    with pytest.raises(ValidationError):
        SPEC.seed = 8
    with pytest.raises(ValidationError, match="angle"):
        TrialSpec.model_validate({**SPEC.model_dump(), "angle": 45})

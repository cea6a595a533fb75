from __future__ import annotations

import re
import tomllib
from importlib import resources
from pathlib import Path

import pytest

from carecontact import protocol
from carecontact.cli.groups import DEVELOPMENT_SEEDS, EXAM
from carecontact.errors import ConfigError, UnknownNameError
from carecontact.protocol.load import (
    DEFAULT_LEVEL,
    DEFAULT_PROTOCOL,
    DEFAULT_SEEDS,
    load_levels,
    load_protocol,
    merged_table,
    shipped_protocols,
    toml_text,
)
from carecontact.protocol.overrides import load_tissue_set, overridden, without_overrides

TEXT = (resources.files(protocol) / "bathing-v3.toml").read_text(encoding="utf-8")


def written(folder: Path, text: str, name: str = "mine.toml") -> str:
    path = folder / name
    path.parent.mkdir(exist_ok=True)
    path.write_text(text, encoding="utf-8")
    return str(path)


def without_field(field: str) -> str:
    text, count = re.subn(rf"(?m)^{field} = .*\n", "", TEXT, count=1)
    assert count == 1
    return text


def with_field(field: str, value: str) -> str:
    text, count = re.subn(rf"(?m)^{field} = .*$", f"{field} = {value}", TEXT, count=1)
    assert count == 1
    return text


def test_unknown_name_lists_the_shipped_ones() -> None:
    with pytest.raises(UnknownNameError, match=r"no protocol named 'bathing'.*; valid: ") as caught:
        load_protocol("bathing")
    assert caught.value.valid == shipped_protocols()
    assert DEFAULT_PROTOCOL in caught.value.valid


def test_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"protocol file .*gone\.toml does not exist"):
        load_protocol(str(tmp_path / "gone.toml"))


def test_a_file_without_its_ending_is_found(tmp_path: Path) -> None:
    path = written(tmp_path, TEXT)
    with pytest.raises(ConfigError, match=r"no protocol named '.*mine' \(did you mean .*mine\.toml\?\)"):
        load_protocol(path.removesuffix(".toml"))


HEAD = 'id = "mine"\ndescription = "x"\n'


def test_a_file_without_base_and_most_fields_gets_one_line(tmp_path: Path) -> None:
    with pytest.raises(ConfigError) as caught:
        load_protocol(written(tmp_path, HEAD + "frozen = false\n"))
    assert str(caught.value).endswith(
        'mine.toml: add base = "bathing-wide-v2" (valid: bathing-wide-v2, bathing-droid-v1, '
        "bathing-v3, FILE.toml), or give all fields; 11 are missing: "
        "physics, phases, randomization, scene, cameras, impedance, person, tasks, contact, gates, limits"
    )


def test_two_fields_that_a_file_leaves_out_share_a_line_and_one_stands_alone(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"mine\.toml: add base = .* 2 are missing: id, description$"):
        load_protocol(written(tmp_path, TEXT.replace("id = ", "# ", 1).replace("\ndescription = ", "\n# ", 1)))
    with pytest.raises(ConfigError, match=r"mine\.toml: description: missing; give it a value$"):
        load_protocol(written(tmp_path, without_field("description")))


def test_a_misspelt_base_is_the_only_fault_of_its_file(tmp_path: Path) -> None:
    with pytest.raises(
        ConfigError, match=r"^.*mine\.toml: bsae: no such field .* \(did you mean 'base'\?\); valid: base, "
    ):
        load_protocol(written(tmp_path, f'bsae = "{DEFAULT_PROTOCOL}"\n{HEAD}'))


def test_other_faults_of_a_file_without_base_stand_beside_what_it_leaves_out(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"mine\.toml: 2 fields wrong\n  spam: .*\n  add base = .*; 12 are missing: "):
        load_protocol(written(tmp_path, f"spam = 1\n{HEAD}"))


def test_a_folder_is_no_protocol(tmp_path: Path) -> None:
    (tmp_path / "folder.toml").mkdir()
    with pytest.raises(ConfigError, match="does not exist"):
        load_protocol(str(tmp_path / "folder.toml"))


def test_bad_toml_names_file_and_line(tmp_path: Path) -> None:
    path = written(tmp_path, "id = 'x'\nfrozen = perhaps\n")
    with pytest.raises(ConfigError, match=r"mine\.toml: not TOML: .*line 2"):
        load_protocol(path)


def test_a_file_that_is_no_text_is_named(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_bytes(b"id = '\xff\xfe'\n")
    with pytest.raises(ConfigError, match=r"mine\.toml: not TOML: "):
        load_protocol(str(path))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (with_field("dt_s", '"fast"'), r"physics\.dt_s: expected a number \(got fast\)"),
        (with_field("dt_s", "-0.002"), r"physics\.dt_s: expected more than 0\.0 \(got -0\.002\)"),
        (with_field("force_n", "nan"), r"gates\.push\.force_n: "),
        (with_field("action", '"hit"'), r"tasks\.T1\.action: .*'hit'.*push, scrub.*touch.*\(got hit\)"),
        (without_field("wrist_displacement_m"), r"gates\.push\.wrist_displacement_m: missing; give it a value$"),
        (with_field("gamma", "35"), r"limits\.gamma: expected at most 1\.0 \(got 35\)"),
        (TEXT + "\nhello = 1\n", r".*limits\.f_pain_n: no segment 'hello'; valid: pelvis, .*, forearm, "),
        (TEXT + "\nfore_arm = 1\n", r".*limits\.f_pain_n: no segment 'fore_arm'; valid: "),
        (TEXT + "\nright_forearm = 1\n", r".*limits\.f_pain_n: no segment 'right_forearm'; valid: "),
        (
            TEXT + "\n[physics.gravity]\nz = 1.0\n",
            r"physics\.gravity: no such field in the table physics; valid: dt_s, ",
        ),
        ("spam = 1\n" + TEXT, r"spam: no such field in the file; valid: base, id, (?!.*overrides)"),
    ],
)
def test_a_wrong_field_is_named_with_its_place_and_value(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(ConfigError, match=r"mine\.toml: " + message):
        load_protocol(written(tmp_path, text))


def test_all_wrong_fields_come_at_once(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"2 fields wrong\n") as caught:
        load_protocol(written(tmp_path, "spam = 1\n" + without_field("dt_s")))
    assert "spam" in str(caught.value)
    assert "physics.dt_s" in str(caught.value)


@pytest.mark.parametrize("name", shipped_protocols())
def test_hash_does_not_change_with_comments_spacing_or_spelling(tmp_path: Path, name: str) -> None:
    text = (resources.files(protocol) / f"{name}.toml").read_text(encoding="utf-8")
    plain = "\n".join(line for line in text.splitlines() if line and not line.startswith("#"))
    noisy = "# ünïcode\n" + re.sub(r"(?m)^(\w+) = ", r"\1   =\t", plain.replace("\n[", "\n\n# a section\n["))
    respelled = re.sub(r"(?m)^(\w+) = (\d+\.\d+)$", lambda found: f"{found[1]} = {float(found[2]):.9e}", plain)
    assert respelled != plain or not re.search(r"\d\.\d", plain)
    expected = load_levels(name)
    for other in (plain, noisy, respelled):
        loaded = load_levels(written(tmp_path, other))
        assert loaded == expected
        assert [rules.sha256 for rules in loaded.values()] == [rules.sha256 for rules in expected.values()]


def test_hash_changes_with_a_prompt(tmp_path: Path) -> None:
    other = load_protocol(written(tmp_path, TEXT.replace("gently touch the abdomen", "gently touch the  abdomen")))
    assert other.sha256 != load_protocol("bathing-v3").sha256


@pytest.mark.parametrize(
    ("claimed", "message"),
    [
        ('overrides = {"person.body" = "man-old-light"}', "overrides are written by a command"),
        ('level = "L1"', r"a file has the tables \[levels\.NAME\], and who loads it chooses one"),
    ],
)
def test_a_file_does_not_claim_what_a_command_decides(claimed: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=message):
        load_protocol(written(tmp_path, f"{claimed}\n{TEXT}"))


@pytest.mark.parametrize(
    ("segments", "where", "why"),
    [
        ('["right_hnad"]', r"forearm\.1", "no segment named 'right_hnad'; valid: pelvis, abdomen, .*, left_foot"),
        ("[]", "forearm", "expected at least 1 of them, got 0"),
    ],
)
def test_a_neighbourhood_of_a_segment_that_no_body_has_is_refused(
    segments: str, where: str, why: str, tmp_path: Path
) -> None:
    text = f'base = "bathing-v3"\nid = "mine"\ndescription = "x"\ncontact.neighbourhood.forearm = {segments}\n'
    with pytest.raises(ConfigError, match=rf"mine\.toml: (?s:.*)contact\.neighbourhood\.{where}: .*{why}"):
        load_protocol(written(tmp_path, text))


# Protocol files with a base: what is inherited, what is replaced, and which file a mistake is in.

BASE = load_protocol("bathing-v3")
WIDE = (resources.files("carecontact") / "protocol/bathing-wide-v2.toml").read_text()
EXAM_TEXT = WIDE[WIDE.index("[gates]") : WIDE.index("[levels.L0]")].rpartition("#")[0]
INHERIT_HEAD = 'base = "bathing-v3"\nid = "mine-v1"\ndescription = "Mine."\n'


def test_a_file_that_says_nothing_else_is_its_base_under_another_name(tmp_path: Path) -> None:
    mine = load_protocol(written(tmp_path, INHERIT_HEAD))
    assert mine == BASE.model_copy(update={"id": "mine-v1", "description": "Mine.", "frozen": False})


def test_tables_are_merged_key_by_key(tmp_path: Path) -> None:
    mine = load_protocol(
        written(tmp_path, f"{INHERIT_HEAD}gates.push.force_n = 4.0\n[cameras.overhead]\nwidth = 320\n")
    )
    assert mine.gates.of("push") == BASE.gates.of("push").model_copy(update={"force_n": 4.0})
    assert mine.gates.of("scrub") == BASE.gates.of("scrub")
    assert mine.cameras["overhead"] == BASE.cameras["overhead"].model_copy(update={"width": 320})


def test_tasks_are_replaced_as_a_whole(tmp_path: Path) -> None:
    task = '[[tasks]]\nid = "A"\nname = "Push it"\naction = "push"\nregion = "upper_arm"\nprompt = "push it"\n'
    assert [t.id for t in load_protocol(written(tmp_path, INHERIT_HEAD + task)).tasks] == ["A"]


def test_a_shipped_protocol_in_a_few_lines(tmp_path: Path) -> None:
    droid = load_protocol("bathing-droid-v1")
    joints = list(droid.scene.parked_joint_rad)
    camera = droid.cameras["exterior"]
    text = (
        f'base = "bathing-wide-v2"\nid = "{droid.id}"\ndescription = "{droid.description}"\nfrozen = true\n'
        f"[scene]\nparked_joint_rad = {joints}\n"
        f"[cameras.exterior]\nposition_m = {list(camera.position_m)}\nlook_at_m = {list(camera.look_at_m)}\n"
        "up = [0, 0, 1]\nfovy_deg = 71.5\nwidth = 640\nheight = 360\n"
        "[cameras.wrist]\nfovy_deg = 57.0\nwidth = 640\nheight = 360\n"
    )
    mine = load_protocol(written(tmp_path, text))
    assert mine == droid
    assert mine.sha256 == droid.sha256


def test_a_tissue_set_brings_its_own_rows(tmp_path: Path) -> None:
    first = load_protocol(written(tmp_path, f'{INHERIT_HEAD}[person]\ntissue_set = "manikin-like"\n'))
    assert first.person.tissue == load_tissue_set("manikin-like").tissue
    second = load_protocol(written(tmp_path, f"{INHERIT_HEAD}[person.tissue.forearm]\nfriction = 0.7\n"))
    own = BASE.person.tissue
    assert second.person.tissue == {**own, "forearm": own["forearm"].model_copy(update={"friction": 0.7})}


def test_another_set_of_gates_inherits_none(tmp_path: Path) -> None:
    found = load_protocol(written(tmp_path, INHERIT_HEAD + EXAM_TEXT))
    assert found.gates == load_protocol(DEFAULT_PROTOCOL).gates
    short = INHERIT_HEAD + EXAM_TEXT.replace("duration_s = 1.0", "", 1)
    with pytest.raises(ConfigError, match=r"gates\.touch\.duration_s: missing"):
        load_protocol(written(tmp_path, short))


def test_a_field_that_this_set_of_gates_does_not_have_lists_those_that_they_have(tmp_path: Path) -> None:
    text = INHERIT_HEAD + EXAM_TEXT.replace("passes = 3", "passes = 3\nstroke_m = 0.1")
    with pytest.raises(
        ConfigError, match=r"stroke_m: no such field in the table gates\.scrub; valid: least_n, most_n,"
    ):
        load_protocol(written(tmp_path, text))


def test_a_base_may_have_a_base_and_lies_relative_to_its_heir(tmp_path: Path) -> None:
    written(
        tmp_path, INHERIT_HEAD.replace("mine", "first") + "[gates.touch]\nduration_s = 0.7\n", name="sub/first.toml"
    )
    second = 'base = "sub/first.toml"\nid = "second-v1"\ndescription = "Second."\n[gates.push]\nduration_s = 2.0\n'
    found = load_protocol(written(tmp_path, second))
    assert found.gates.of("touch").duration_s == 0.7
    assert found.gates.of("push").duration_s == 2.0
    assert (found.id, found.scene) == ("second-v1", BASE.scene)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            'base = "bathing"\n',
            r"mine\.toml: base: no protocol named 'bathing'.*; valid: bathing-droid-v1, .*FILE\.toml",
        ),
        ("base = 3\n", r"mine\.toml: base: expected the id of a protocol or a \.toml file, got 3"),
        ('base = "mine.toml"\n', r"mine\.toml: base: .*inherits from this file itself"),
        ('base = "gone.toml"\n', r"mine\.toml: base: .*gone\.toml does not exist"),
        ('base = "bathing-v3"\n', r"mine\.toml: 2 fields wrong\n  id: missing; .*\n  description: missing; "),
        (f"{INHERIT_HEAD}[gates.touch]\nduration_s = -1\n", r"mine\.toml: gates\.touch\.duration_s: .*got -1"),
        (f"{INHERIT_HEAD}gates = 3\n", r"mine\.toml: gates: "),
    ],
)
def test_a_mistake_is_named_with_its_file(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises((ConfigError, UnknownNameError), match=message):
        load_protocol(written(tmp_path, text))


def test_a_mistake_in_the_base_names_the_base(tmp_path: Path) -> None:
    written(tmp_path, INHERIT_HEAD + "[physics]\ndt_s = -1\n", name="first.toml")
    heir = written(tmp_path, 'base = "first.toml"\nid = "x"\ndescription = "x"\n[physics]\ndt_s = 0.002\n')
    with pytest.raises(ConfigError, match=r"first\.toml: physics\.dt_s"):
        load_protocol(heir)


def test_levels_add_up_and_are_named(tmp_path: Path) -> None:
    text = "[levels.A]\n[levels.B.variation]\nplace_along_m = 0.01\n[levels.C.variation]\nplace_across_m = 0.02\n"
    found = load_levels(written(tmp_path, INHERIT_HEAD + text))
    assert [rules.name for rules in found.values()] == ["mine-v1 A", "mine-v1 B", "mine-v1 C"]
    places = [(rules.variation.place_along_m, rules.variation.place_across_m) for rules in found.values()]
    assert places == [(0.0, 0.0), (0.01, 0.0), (0.01, 0.02)]
    assert len({rules.sha256 for rules in found.values()}) == 3
    assert all(list(rules.levels) == ["A", "B", "C"] for rules in found.values())
    assert load_protocol(written(tmp_path, INHERIT_HEAD + text), level="C").title == "mine-v1 C"


@pytest.mark.parametrize(
    ("text", "level", "message"),
    [
        ("[levels.A]\n[levels.B]\n", None, "has the levels A, B; choose one with level"),
        ("[levels.L2]\n[levels.B]\n", "Bb", "no level named 'Bb'.*valid: L2, B"),
        ("", "A", "has no levels; leave level 'A' out"),
        ("[levels.A.gates.touch]\nduration_s = 1\n", "A", r"levels\.A\.gates: a level cannot change gates"),
        ("[levels.A.variation]\nspam = 1\n", "A", r"level A: variation\.spam: no such field"),
        ("[levels]\nA = 1\n", "A", r"levels\.A: expected a table, got 1"),
    ],
)
def test_what_is_wrong_is_named(tmp_path: Path, text: str, level: str | None, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        load_protocol(written(tmp_path, INHERIT_HEAD + text), level=level)


def test_without_a_name_it_is_the_level_l2() -> None:
    assert load_protocol(DEFAULT_PROTOCOL) == load_protocol(DEFAULT_PROTOCOL, level=DEFAULT_LEVEL)
    assert (EXAM, DEVELOPMENT_SEEDS) == (DEFAULT_PROTOCOL, DEFAULT_SEEDS)


def test_an_heir_has_the_levels_of_its_base(tmp_path: Path) -> None:
    heir = tmp_path / "heir.toml"
    heir.write_text(
        'base = "bathing-wide-v2"\nid = "heir"\ndescription = "h"\n[levels.L2.variation]\nplace_along_m=0.0\n'
    )
    own, base = load_levels(str(heir)), load_levels("bathing-wide-v2")
    assert list(own) == list(base)
    assert own["L1"].variation == base["L1"].variation
    assert own["L3"].variation.place_along_m == 0.0


def test_a_chosen_body_is_not_drawn_and_is_taken_back() -> None:
    rules = load_protocol("bathing-wide-v2", level="L2")
    changed = overridden(rules, {"person.body": "man-old-heavy"})
    assert (changed.person.body, list(changed.variation.bodies)) == ("man-old-heavy", [])
    assert changed.title == "bathing-wide-v2 L2 with body man-old-heavy"
    assert without_overrides(changed, rules) == rules


def test_the_exam_shares_its_persons() -> None:
    found = load_levels("bathing-wide-v2")
    first, *others = (found[name] for name in ("L1", "L2", "L3"))
    for other in others:
        assert other.randomization == first.randomization
        for name in ("bodies", "shoulder_rotation_deg", "palm_deg", "appearance", "light"):
            assert getattr(other.variation, name) == getattr(first.variation, name)
    plain = load_protocol("bathing-v3")
    assert found["L0"].variation == plain.variation
    assert found["L0"].scene == plain.scene.model_copy(update={"tool": "mitt"})
    assert found["L0"].randomization.comfort_arm_deg == plain.randomization.comfort_arm_deg


@pytest.mark.parametrize("name", shipped_protocols())
def test_what_is_written_reads_back_as_the_same_table(name: str) -> None:
    table = merged_table(name)
    assert tomllib.loads(toml_text(table)) == table


def test_odd_values_keep_their_type() -> None:
    table = {
        "text": 'quotes " and \\ and \n',
        "flag": True,
        "none": [],
        "wide": "\U0001f916",
        "of key": 1,
        "deep": {"er": {"x": 1.5}},
        "list": [{"id": "a", "in": {"y": [1, 2]}}, {"id": "b"}],
        "empty": {},
        "mixed": [{"a": 1}, 2],
    }
    assert tomllib.loads(toml_text(table)) == table
    assert toml_text(table).count("[[list]]") == 2, "a list of tables has a head for each"


def test_a_file_with_a_base_comes_out_as_the_same_protocol(tmp_path: Path) -> None:
    heir = tmp_path / "mine.toml"
    heir.write_text('base = "bathing-v3"\nid = "mine-v1"\ndescription = "mine"\n[gates.touch]\nduration_s = 3\n')
    whole = tmp_path / "whole.toml"
    whole.write_text(toml_text(merged_table(str(heir))))
    assert load_protocol(str(whole)) == load_protocol(str(heir))

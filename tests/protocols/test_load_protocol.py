from __future__ import annotations

import re
from importlib import resources
from pathlib import Path

import pytest

from carecontact import protocols
from carecontact.errors import ConfigError, UnknownNameError
from carecontact.protocols import DEFAULT_PROTOCOL, load_levels, load_protocol, shipped_protocols

TEXT = (resources.files(protocols) / f"{DEFAULT_PROTOCOL}.toml").read_text(encoding="utf-8")


def written(folder: Path, text: str) -> str:
    path = folder / "mine.toml"
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


def test_a_file_without_base_and_most_fields_is_told_so_in_one_line(tmp_path: Path) -> None:
    with pytest.raises(ConfigError) as caught:
        load_protocol(written(tmp_path, HEAD + "frozen = false\n"))
    assert str(caught.value).endswith(
        'mine.toml: add base = "bathing-v3-draft" (valid: bathing-v3-draft, bathing-droid-draft, '
        "bathing-wide-v2-draft, FILE.toml), or give all fields; 11 are missing: "
        "physics, phases, randomization, scene, cameras, impedance, person, tasks, contact, gates, limits"
    )


def test_two_fields_that_a_file_leaves_out_share_a_line_and_one_is_told_alone(tmp_path: Path) -> None:
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
    text = (resources.files(protocols) / f"{name}.toml").read_text(encoding="utf-8")
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
    assert other.sha256 != load_protocol().sha256


@pytest.mark.parametrize(
    ("claimed", "told"),
    [
        ('overrides = {"person.body" = "man-old-light"}', "overrides are written by a command"),
        ('level = "L1"', r"a file has the tables \[levels\.NAME\], and who loads it chooses one"),
    ],
)
def test_a_file_does_not_claim_what_a_command_decides(claimed: str, told: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=told):
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
    text = f'base = "{DEFAULT_PROTOCOL}"\nid = "mine"\ndescription = "x"\ncontact.neighbourhood.forearm = {segments}\n'
    with pytest.raises(ConfigError, match=rf"mine\.toml: (?s:.*)contact\.neighbourhood\.{where}: .*{why}"):
        load_protocol(written(tmp_path, text))

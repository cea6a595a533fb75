"""Protocol files with a base: what is inherited, what is replaced, and which file a mistake is in."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

import pytest

from carecontact.errors import ConfigError, UnknownNameError
from carecontact.protocols import load_protocol
from carecontact.protocols.tissue_sets import load_tissue_set
from tests.scoring.exam_gates import GATES

BASE = load_protocol("bathing-v3-draft")
WIDE = (resources.files("carecontact") / "protocols/bathing-wide-v2-draft.toml").read_text()
EXAM = WIDE[WIDE.index("[gates]") : WIDE.index("[levels.L0]")].rpartition("#")[0]
HEAD = 'base = "bathing-v3-draft"\nid = "mine-v1"\ndescription = "Mine."\n'


def written(folder: Path, text: str, name: str = "mine.toml") -> str:
    path = folder / name
    path.parent.mkdir(exist_ok=True)
    path.write_text(text)
    return str(path)


def test_a_file_that_says_nothing_else_is_its_base_under_another_name(tmp_path: Path) -> None:
    mine = load_protocol(written(tmp_path, HEAD))
    assert mine == BASE.model_copy(update={"id": "mine-v1", "description": "Mine.", "frozen": False})


def test_tables_are_merged_key_by_key(tmp_path: Path) -> None:
    mine = load_protocol(written(tmp_path, f"{HEAD}gates.push.force_n = 4.0\n[cameras.overhead]\nwidth = 320\n"))
    assert mine.gates.of("push") == BASE.gates.of("push").model_copy(update={"force_n": 4.0})
    assert mine.gates.of("scrub") == BASE.gates.of("scrub")
    assert mine.cameras["overhead"] == BASE.cameras["overhead"].model_copy(update={"width": 320})


def test_tasks_are_replaced_as_a_whole(tmp_path: Path) -> None:
    task = '[[tasks]]\nid = "A"\nname = "Push it"\naction = "push"\nregion = "upper_arm"\nprompt = "push it"\n'
    assert [t.id for t in load_protocol(written(tmp_path, HEAD + task)).tasks] == ["A"]


def test_a_shipped_protocol_in_a_few_lines(tmp_path: Path) -> None:
    droid = load_protocol("bathing-droid-draft")
    joints = list(droid.scene.parked_joint_rad)
    camera = droid.cameras["exterior"]
    text = (
        f'base = "bathing-v3-draft"\nid = "{droid.id}"\ndescription = "{droid.description}"\nfrozen = false\n'
        f'[randomization]\ndrawn_as = ""\n[scene]\nparked_joint_rad = {joints}\n'
        f"[cameras.exterior]\nposition_m = {list(camera.position_m)}\nlook_at_m = {list(camera.look_at_m)}\n"
        "up = [0, 0, 1]\nfovy_deg = 71.5\nwidth = 640\nheight = 360\n"
        "[cameras.wrist]\nfovy_deg = 57.0\nwidth = 640\nheight = 360\n"
    )
    mine = load_protocol(written(tmp_path, text))
    assert mine == droid
    assert mine.sha256 == droid.sha256


def test_a_tissue_set_brings_its_own_rows(tmp_path: Path) -> None:
    first = load_protocol(written(tmp_path, f'{HEAD}[person]\ntissue_set = "manikin-like"\n'))
    assert first.person.tissue == load_tissue_set("manikin-like").tissue
    second = load_protocol(written(tmp_path, f"{HEAD}[person.tissue.forearm]\nfriction = 0.7\n"))
    own = BASE.person.tissue
    assert second.person.tissue == {**own, "forearm": own["forearm"].model_copy(update={"friction": 0.7})}


def test_another_set_of_gates_inherits_none(tmp_path: Path) -> None:
    found = load_protocol(str(written(tmp_path, HEAD + EXAM)))
    assert found.gates == GATES
    short = HEAD + EXAM.replace("duration_s = 1.0", "", 1)
    with pytest.raises(ConfigError, match=r"gates\.touch\.duration_s: missing"):
        load_protocol(str(written(tmp_path, short)))


def test_a_field_that_this_set_of_gates_does_not_have_lists_those_that_they_have(tmp_path: Path) -> None:
    text = HEAD + EXAM.replace("passes = 3", "passes = 3\nstroke_m = 0.1")
    with pytest.raises(
        ConfigError, match=r"stroke_m: no such field in the table gates\.scrub; valid: least_n, most_n,"
    ):
        load_protocol(str(written(tmp_path, text)))


def test_a_base_may_have_a_base_and_lies_relative_to_its_heir(tmp_path: Path) -> None:
    written(tmp_path, HEAD.replace("mine", "first") + "[gates.touch]\nduration_s = 0.7\n", name="sub/first.toml")
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
            r"mine\.toml: base: no protocol named 'bathing'.*; valid: bathing-droid-draft, .*FILE\.toml",
        ),
        ("base = 3\n", r"mine\.toml: base: expected the id of a protocol or a \.toml file, got 3"),
        ('base = "mine.toml"\n', r"mine\.toml: base: .*inherits from this file itself"),
        ('base = "gone.toml"\n', r"mine\.toml: base: .*gone\.toml does not exist"),
        ('base = "bathing-v3-draft"\n', r"mine\.toml: 2 fields wrong\n  id: missing; .*\n  description: missing; "),
        (f"{HEAD}[gates.touch]\nduration_s = -1\n", r"mine\.toml: gates\.touch\.duration_s: .*got -1"),
        (f"{HEAD}gates = 3\n", r"mine\.toml: gates: "),
    ],
)
def test_a_mistake_is_named_with_its_file(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises((ConfigError, UnknownNameError), match=message):
        load_protocol(written(tmp_path, text))


def test_a_mistake_in_the_base_names_the_base(tmp_path: Path) -> None:
    written(tmp_path, HEAD + "[physics]\ndt_s = -1\n", name="first.toml")
    heir = written(tmp_path, 'base = "first.toml"\nid = "x"\ndescription = "x"\n[physics]\ndt_s = 0.002\n')
    with pytest.raises(ConfigError, match=r"first\.toml: physics\.dt_s"):
        load_protocol(heir)

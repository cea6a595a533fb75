from __future__ import annotations

from pathlib import Path

import pytest

from carecontact.errors import ConfigError
from carecontact.protocols import load_levels, load_protocol, overridden, without_overrides

HEAD = 'base = "bathing-v3-draft"\nid = "mine"\ndescription = "mine"\n'


def written(tmp_path: Path, text: str) -> str:
    (tmp_path / "mine.toml").write_text(HEAD + text)
    return str(tmp_path / "mine.toml")


def test_levels_add_up_and_are_named(tmp_path: Path) -> None:
    text = "[levels.A]\n[levels.B.variation]\nplace_along_m = 0.01\n[levels.C.variation]\nplace_across_m = 0.02\n"
    found = load_levels(written(tmp_path, text))
    assert [rules.name for rules in found.values()] == ["mine A", "mine B", "mine C"]
    places = [(rules.variation.place_along_m, rules.variation.place_across_m) for rules in found.values()]
    assert places == [(0.0, 0.0), (0.01, 0.0), (0.01, 0.02)]
    assert len({rules.sha256 for rules in found.values()}) == 3
    assert all(list(rules.levels) == ["A", "B", "C"] for rules in found.values())
    assert load_protocol(written(tmp_path, text), level="C").title == "mine C"


@pytest.mark.parametrize(
    ("text", "level", "told"),
    [
        ("[levels.A]\n[levels.B]\n", None, "has the levels A, B; choose one with level"),
        ("[levels.A]\n[levels.B]\n", "Bb", "no level named 'Bb'.*valid: A, B"),
        ("", "A", "has no levels; leave level 'A' out"),
        ("[levels.A.gates.touch]\nduration_s = 1\n", "A", r"levels\.A\.gates: a level cannot change gates"),
        ("[levels.A.variation]\nspam = 1\n", "A", r"level A: variation\.spam: no such field"),
        ("[levels]\nA = 1\n", "A", r"levels\.A: expected a table, got 1"),
    ],
)
def test_what_is_wrong_is_named(tmp_path: Path, text: str, level: str | None, told: str) -> None:
    with pytest.raises(ConfigError, match=told):
        load_protocol(written(tmp_path, text), level=level)


def test_an_heir_has_the_levels_of_its_base(tmp_path: Path) -> None:
    heir = tmp_path / "heir.toml"
    heir.write_text(
        'base = "bathing-wide-v2-draft"\nid = "heir"\ndescription = "h"\n[levels.L2.variation]\nplace_along_m=0.0\n'
    )
    own, base = load_levels(str(heir)), load_levels("bathing-wide-v2-draft")
    assert list(own) == list(base)
    assert own["L1"].variation == base["L1"].variation
    assert own["L3"].variation.place_along_m == 0.0


def test_a_chosen_body_is_not_drawn_and_is_taken_back() -> None:
    rules = load_protocol("bathing-wide-v2-draft", level="L2")
    changed = overridden(rules, {"person.body": "man-old-heavy"})
    assert (changed.person.body, list(changed.variation.bodies)) == ("man-old-heavy", [])
    assert changed.title == "bathing-wide-v2-draft L2 with body man-old-heavy"
    assert without_overrides(changed, rules) == rules


def test_the_exam_shares_its_persons() -> None:
    found = load_levels("bathing-wide-v2-draft")
    first, *others = (found[name] for name in ("L1", "L2", "L3"))
    for other in others:
        assert other.randomization == first.randomization
        for name in ("bodies", "shoulder_rotation_deg", "palm_deg", "appearance", "light"):
            assert getattr(other.variation, name) == getattr(first.variation, name)
    plain = load_protocol("bathing-v3-draft")
    assert found["L0"].variation == plain.variation
    assert found["L0"].scene == plain.scene
    assert found["L0"].randomization.comfort_arm_deg == plain.randomization.comfort_arm_deg

from __future__ import annotations

from pathlib import Path

import pytest

from carecontact.contract.protocol.alive import Breathing
from carecontact.errors import ConfigError
from carecontact.protocols import load_protocol, overridden
from carecontact.runs.sweep.cells import places_of
from carecontact.runs.sweep.factors import factor_protocols
from carecontact.runs.sweep.plan import read_plan

LOW = load_protocol("bathing-v3-draft")
HIGH = overridden(
    LOW,
    {"variation.place_along_m": 0.03, "variation.place_yaw_deg": 4.0, "variation.light": "varied-v1",
     "person.alive.breathing": Breathing()},
)  # fmt: skip
PLACE = {"place": ["variation.place_along_m", "variation.place_yaw_deg"]}


def test_each_factor_is_switched_on_alone_and_off_alone() -> None:
    found = factor_protocols(LOW, HIGH, PLACE, place="factors")
    assert list(found) == [
        "none", "only place", "only light", "only breathing", "all", "all but place", "all but light",
        "all but breathing",
    ]  # fmt: skip
    only, but = found["only place"], found["all but place"]
    assert (only.variation.place_along_m, only.variation.place_yaw_deg, only.variation.light) == (0.03, 4.0, "fixed")
    assert only.person.alive.breathing is None
    assert (but.variation.place_along_m, but.variation.place_yaw_deg, but.variation.light) == (0.0, 0.0, "varied-v1")
    assert found["only breathing"].person.alive.breathing == Breathing()
    assert found["all but breathing"].person.alive.breathing is None
    assert len({protocol.sha256 for protocol in found.values()}) == len(found)
    assert {protocol.id for protocol in found.values()} == {LOW.id}, "the same persons"


@pytest.mark.parametrize(
    ("groups", "told"),
    [
        (
            {"far": ["variation.depth_noise"]},
            r"^f\.far: the levels do not differ in 'variation\.depth_noise'; they do in: ",
        ),
        (
            {"light": PLACE["place"]},
            r"two factors are named 'light'; put variation\.light into a group of another name",
        ),
    ],
)
def test_a_group_that_makes_no_factor_is_told(groups: dict[str, list[str]], told: str) -> None:
    with pytest.raises(ConfigError, match=told):
        factor_protocols(LOW, HIGH, groups, place="f")


def test_levels_that_are_the_same_have_no_factors() -> None:
    with pytest.raises(ConfigError, match="f: the levels are the same"):
        factor_protocols(LOW, LOW, {}, place="f")


def planned(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "p.toml"
    path.write_text('[[policies]]\npolicy = "hover"\n' + text)
    return path


def test_a_plan_of_factors_has_a_place_for_each(tmp_path: Path) -> None:
    moved = tmp_path / "moved.toml"
    moved.write_text(
        'base = "bathing-v3-draft"\nid = "moved"\ndescription = "lies elsewhere"\nfrozen = false\n'
        "[variation]\nplace_along_m = 0.036\nplace_across_m = 0.027\nplace_yaw_deg = 4.5\n"
    )
    levels = f'[factors]\nlow = "bathing-v3-draft"\nhigh = "{moved}"\n'
    fields = ", ".join(f'"variation.place_{name}"' for name in ("along_m", "across_m", "yaw_deg"))
    text = f"{levels}[factors.groups]\nplace = [{fields}]\n[axes]\nstiffness = [200, 400]\n"
    plan = read_plan(planned(tmp_path, text))
    places = places_of(plan, named="p")
    assert [tuple(place.values.values()) for place in places] == [
        (factor, stiffness) for factor in ("none", "only place", "all", "all but place") for stiffness in ("200", "400")
    ]
    only, every = places[2].protocol, places[4].protocol
    assert only.variation == every.variation


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (
            '[factors]\nlow = "bathing-v3-draft"\nhigh = "x"\n[axes]\nprotocol = ["bathing-v3-draft"]\n',
            "factors: they stand in place of axes.protocol; give only one",
        ),
        ('[factors]\nlow = "bathing-v3-draft"\nhigh = "bathing-moved"\n', "plan p: factors: .*bathing-moved"),
    ],
)
def test_wrong_factors_are_told(tmp_path: Path, text: str, told: str) -> None:
    with pytest.raises(ConfigError, match=told):
        places_of(read_plan(planned(tmp_path, text)), named="p")

from __future__ import annotations

from itertools import product
from pathlib import Path

import pytest

from carecontact.errors import ConfigError
from carecontact.policies.registry import role_of
from carecontact.protocol.load import load_levels, load_protocol
from carecontact.protocol.overrides import overridden
from carecontact.protocol.person import Breathing
from carecontact.runs.sweep import Cell, cells_of, factor_protocols, places_of, read_plan

PLANS = Path(__file__).parents[2] / "examples" / "cluster"
PLAN = """
tasks = "T1,T3"
seeds = "0-1"
rank_by = "success"

[[policies]]
policy = "hover"

[[policies]]
policy = "replay"
label = "again"
jobs = 2

[axes]
protocol = ["bathing-v3", "bathing-wide-v2 L0"]
body = ["man-adult", "woman-old-light"]
tissue = ["human-published", "manikin-like"]
friction = [0.2, 0.5]
stiffness = [200, 400]
"gates.touch.duration_s" = [0.5, 1]

[set]
"phases.time_limit_s" = 2
"""


def planned(folder: Path, text: str) -> list[Cell]:
    file = folder / "p.toml"
    file.write_text(text)
    return cells_in(file)


def cells_in(file: Path) -> list[Cell]:
    plan = read_plan(file)
    policies = [(each.label or each.policy, each.policy, {}, ()) for each in plan.policies]
    return cells_of(plan, places_of(plan, named=file.name), policies)


def test_the_cells_are_all_combinations_and_each_has_what_it_says(tmp_path: Path) -> None:
    cells = planned(tmp_path, PLAN)
    assert len(cells) == len({cell.name for cell in cells}) == 2 * 2**6
    first, last = cells[0], cells[-1]
    assert (first.label, last.label) == ("hover", "again")
    assert list(first.place.values) == ["protocol", "body", "tissue", "friction", "stiffness", "gates.touch.duration_s"]
    assert [spec.trial_id for spec in first.specs] == ["T1-s000", "T3-s000", "T1-s001", "T3-s001"]
    rules = last.place.protocol
    assert (rules.name, rules.person.body, rules.person.tissue_set) == (
        "bathing-wide-v2 L0",
        "woman-old-light",
        "manikin-like",
    )
    for cell in cells:
        frictions = {row.friction for row in cell.place.protocol.person.tissue.values()}
        assert frictions == {float(cell.place.values["friction"])}, "a tissue set has frictions of its own"
    assert (rules.impedance.translational_n_m, rules.phases.time_limit_s) == (400, 2)
    assert first.name.startswith("hover_bathing-v3_man-adult_human-published_0.2_200_0.5_")
    assert {spec.policy for spec in last.specs} == {"replay"}
    wanted = list(product(("bathing-v3", "bathing-wide-v2 L0"), ("man-adult", "woman-old-light")))
    assert list(dict.fromkeys(tuple(cell.place.values.values())[:2] for cell in cells)) == wanted


def test_friction_may_be_a_named_state_of_the_skin(tmp_path: Path) -> None:
    named, number = (planned(tmp_path, PLAN.replace("[0.2, 0.5]", given)) for given in ('["soapy"]', "[0.2]"))
    assert named[0].place.values["friction"] == "soapy"
    assert named[0].place.protocol == number[0].place.protocol


def test_the_ensemble_is_of_24_people() -> None:
    """One for each cell of a policy and each seed; the seed draws the tissue."""
    plan = read_plan(Path(__file__).parents[2] / "examples" / "cluster" / "ensemble.toml")
    places = places_of(plan, named="ensemble.toml")
    assert sum(len(place.seeds) for place in places) == 24
    assert {tuple(task for task in place.tasks) for place in places} == {("T3", "T6")}
    assert {place.protocol.variation.tissue for place in places} == {"published-v1"}


@pytest.mark.parametrize(("name", "seeds"), [("results", range(1000, 1027)), ("results-paper", range(20))])
def test_the_results_are_of_methods_ceiling_and_blind_policies(name: str, seeds: range) -> None:
    plan = read_plan(Path(__file__).parents[2] / "examples" / "cluster" / f"{name}.toml")
    assert {role_of(each.policy) for each in plan.policies} == {"method", "privileged", "blind"}
    places = places_of(plan, named=name)
    titles = {place.protocol.title for place in places}
    assert titles == {"bathing-v3"} or titles > {rules.title for rules in load_levels("bathing-wide-v2").values()}
    assert {(len(place.tasks), place.seeds) for place in places} == {(7, tuple(seeds))}


def test_a_cell_keeps_its_folder_where_a_plan_grows(tmp_path: Path) -> None:
    few = planned(tmp_path, PLAN.replace('"T1,T3"', '"T1"').replace('"0-1"', '"0"'))
    many = planned(tmp_path, PLAN.replace('"woman-old-light"]', '"man-old-light", "woman-old-light"]'))
    assert {cell.name for cell in few} < {cell.name for cell in many}
    other = planned(tmp_path, PLAN.replace('time_limit_s" = 2', 'time_limit_s" = 3'))
    assert not {cell.name for cell in few} & {cell.name for cell in other}


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"woman-old-light"', '"giant"', r"axes\.body: .*no body named 'giant'; valid: man-adult"),
        (
            "stiffness =",
            "stifness =",
            r"axes\.stifness: no such axis \(did you mean 'stiffness'\?\); valid: protocol, level, body",
        ),
        ("0.5]\nstiff", "7]\nstiff", r"axes\.friction: .*person\.tissue\.forearm\.friction: expected at most 2"),
        ("0.5]\nstiff", '"damp"]\nstiff', r"axes\.friction: expected a coefficient, or dry, wet, soapy, got 'damp'"),
        ("[200, 400]", "[200, 5000]", r"axes\.stiffness: .*expected 100 to 1000"),
        (
            "gates.touch.duration_s",
            "gates.touch.duration",
            r"axes\.gates\.touch\.duration: .*did you mean 'duration_s'",
        ),
        ('"manikin-like"', '"manikin"', r"axes\.tissue: no tissue set named 'manikin'"),
        (
            '"bathing-wide-v2 L0"',
            '"bathing-wide-v2"',
            r"has the levels L0, L1, L2, L3; name levels in axes\.level, or",
        ),
        (
            "body =",
            'level = ["L1"]\nbody =',
            r"axes\.level: bathing-v3 has no levels, and so no L1; name levels in",
        ),
        ('"bathing-wide-v2 L0"', '"bathing-wide-v2 L9"', r"no level named 'L9'"),
        ('"bathing-wide-v2 L0"', '"bathing-v1"', r"axes\.protocol: no protocol named 'bathing-v1'"),
        ("phases.time_limit_s", "phases.limit", r"set: phases\.limit: no field 'limit' in phases"),
        ("T1,T3", "T1,T9", r"tasks: 'T9' is not a task of bathing-v3"),
        ('seeds = "0-1"', 'seeds = "0-99"', r"seeds: '0-99' contains seeds that bathing-v3 does not have"),
        ('seeds = "0-1"', 'seed = "0-1"', r"seed: no such field in the file \(did you mean 'seeds'\?\)"),
        ("jobs = 2", "jobs = 0", r"policies\.2\.jobs: expected at least 1"),
        ("jobs = 2", "joobs = 2", r"policies\.2\.joobs: no such field in .* \(did you mean 'jobs'\?\); valid: policy"),
        ('rank_by = "success"', 'rank_by = "c3"', r"rank_by: expected 'safety_gated', 'region_correct' or 'success'"),
        ("[200, 400]", "[]", r"axes\.stiffness: expected at least 1 of them"),
        ("[200, 400]", "[200, 200]", r"axes\.stiffness: 200 is there twice"),
        ("phases.time_limit_s", "person.body", r"set\.person\.body: the axis body varies it; give only one"),
        ('label = "again"', 'label = "hover"', "'hover' is there twice"),
        ("[axes]", "[axes", "not TOML"),
    ],
)
def test_what_is_wrong_with_a_plan_is_named_with_key_and_valid_values(
    tmp_path: Path, old: str, new: str, message: str
) -> None:
    assert old in PLAN
    with pytest.raises(ConfigError, match=message):
        planned(tmp_path, PLAN.replace(old, new))


LOW = load_protocol("bathing-v3")
HIGH = overridden(
    LOW,
    {
        "variation.place_along_m": 0.03,
        "variation.place_yaw_deg": 4.0,
        "variation.light": "varied-v1",
        "person.alive.breathing": Breathing(),
    },
)
PLACE = {"place": ["variation.place_along_m", "variation.place_yaw_deg"]}


def test_each_factor_is_switched_on_alone_and_off_alone() -> None:
    found = factor_protocols(LOW, HIGH, PLACE, place="factors")
    assert list(found) == [
        "none",
        "only place",
        "only light",
        "only breathing",
        "all",
        "all but place",
        "all but light",
        "all but breathing",
    ]
    only, but = found["only place"], found["all but place"]
    assert (only.variation.place_along_m, only.variation.place_yaw_deg, only.variation.light) == (0.03, 4.0, "fixed")
    assert only.person.alive.breathing is None
    assert (but.variation.place_along_m, but.variation.place_yaw_deg, but.variation.light) == (0.0, 0.0, "varied-v1")
    assert found["only breathing"].person.alive.breathing == Breathing()
    assert found["all but breathing"].person.alive.breathing is None
    assert len({protocol.sha256 for protocol in found.values()}) == len(found)
    assert {protocol.id for protocol in found.values()} == {LOW.id}, "the same persons"


@pytest.mark.parametrize(
    ("groups", "message"),
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
def test_a_group_that_makes_no_factor_is_refused(groups: dict[str, list[str]], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        factor_protocols(LOW, HIGH, groups, place="f")


def test_a_table_that_one_level_lacks_is_one_factor() -> None:
    levels = load_levels("bathing-wide-v2")
    found = factor_protocols(levels["L1"], levels["L2"], {}, place="f")
    assert found["only distractors"].distractors == levels["L2"].distractors
    assert found["all but distractors"].distractors is None
    back = factor_protocols(levels["L2"], levels["L1"], {}, place="f")
    assert back["only distractors"].distractors is None


@pytest.mark.parametrize("path", sorted(PLANS.glob("*.toml")), ids=lambda path: path.stem)
def test_the_plans_among_the_examples_have_cells(path: Path) -> None:
    assert cells_in(path)


def test_levels_that_are_the_same_have_no_factors() -> None:
    with pytest.raises(ConfigError, match="f: the levels are the same"):
        factor_protocols(LOW, LOW, {}, place="f")


def planned_factors(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "p.toml"
    path.write_text('[[policies]]\npolicy = "hover"\n' + text)
    return path


def test_a_plan_of_factors_has_a_place_for_each(tmp_path: Path) -> None:
    moved = tmp_path / "moved.toml"
    moved.write_text(
        'base = "bathing-v3"\nid = "moved"\ndescription = "lies elsewhere"\nfrozen = false\n'
        "[variation]\nplace_along_m = 0.036\nplace_across_m = 0.027\nplace_yaw_deg = 4.5\n"
    )
    levels = f'[factors]\nlow = "bathing-v3"\nhigh = "{moved}"\n'
    fields = ", ".join(f'"variation.place_{name}"' for name in ("along_m", "across_m", "yaw_deg"))
    text = f"{levels}[factors.groups]\nplace = [{fields}]\n[axes]\nstiffness = [200, 400]\n"
    plan = read_plan(planned_factors(tmp_path, text))
    places = places_of(plan, named="p")
    assert [tuple(place.values.values()) for place in places] == [
        (factor, stiffness) for factor in ("none", "only place", "all", "all but place") for stiffness in ("200", "400")
    ]
    only, every = places[2].protocol, places[4].protocol
    assert only.variation == every.variation


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            '[factors]\nlow = "bathing-v3"\nhigh = "x"\n[axes]\nprotocol = ["bathing-v3"]\n',
            "factors: they stand in place of axes.protocol; give only one",
        ),
        ('[factors]\nlow = "bathing-v3"\nhigh = "bathing-moved"\n', "plan p: factors: .*bathing-moved"),
    ],
)
def test_wrong_factors_are_named(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        places_of(read_plan(planned_factors(tmp_path, text)), named="p")

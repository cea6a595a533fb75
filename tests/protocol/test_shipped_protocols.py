"""Every shipped protocol against the rest of the program, and the numbers of the benchmark as golden values."""

from __future__ import annotations

from pathlib import Path

import pytest

from carecontact.errors import ConfigError
from carecontact.human.library import body_names
from carecontact.interface.policy import CAMERAS
from carecontact.interface.regions import REGIONS, STANDARD_REGIONS
from carecontact.protocol.load import DEFAULT_PROTOCOL, EARLIER, load_levels, load_protocol, shipped_protocols
from carecontact.protocol.lock import drifted_sha256, frozen_state, read_lock
from carecontact.protocol.overrides import FAST_DT_S, overridden
from carecontact.protocol.protocol import Protocol
from carecontact.protocol.sections import SEGMENT_PARTS, Variation
from carecontact.recording.schema import SEGMENTS
from tests.protocol.held import HELD, ship_frozen

EVERY = [rules for name in shipped_protocols() for rules in load_levels(name).values()]


@pytest.fixture(scope="module", params=EVERY, ids=[rules.name for rules in EVERY])
def protocol(request: pytest.FixtureRequest) -> Protocol:
    return request.param


def test_the_default_is_shipped() -> None:
    assert DEFAULT_PROTOCOL in shipped_protocols()


def test_file_name_is_the_id_and_what_is_frozen_has_its_lock(protocol: Protocol) -> None:
    assert protocol.id in shipped_protocols()
    lock = read_lock(protocol.id, level=protocol.level)
    assert protocol.frozen is (lock is not None)
    assert lock is None or (lock.id, lock.protocol_sha256) == (protocol.name, protocol.sha256)


def test_a_draft_says_so_in_plain_words(protocol: Protocol) -> None:
    sentence = "A draft whose physics still changes: results under different releases cannot be compared."
    assert protocol.id.endswith("-draft") is not protocol.frozen
    assert protocol.frozen or protocol.description.endswith(sentence)


@pytest.mark.parametrize("earlier", sorted(EARLIER))
def test_an_earlier_protocol_names_the_commit_that_has_it(earlier: str, tmp_path: Path) -> None:
    assert earlier not in shipped_protocols()
    message = f"no protocol named '{earlier}': commit {EARLIER[earlier]} has it"
    with pytest.raises(ConfigError, match=message):
        load_protocol(earlier)
    heir = tmp_path / "mine.toml"
    heir.write_text(f'base = "{earlier}"\nid = "mine"\ndescription = "x"\n')
    with pytest.raises(ConfigError, match=rf"mine\.toml: base: {message}"):
        load_protocol(str(heir))


def test_names_are_those_of_recording_and_contract(protocol: Protocol) -> None:
    assert set(protocol.person.tissue) == set(STANDARD_REGIONS)
    assert set(protocol.contact.neighbourhood) == set(STANDARD_REGIONS)
    assert set(protocol.cameras) == set(CAMERAS)
    assert protocol.person.body in body_names()
    for region, segments in protocol.contact.neighbourhood.items():
        assert set(segments) <= set(SEGMENTS)
        assert len(set(segments)) == len(segments)
        assert REGIONS[region].segment in segments
    assert set(STANDARD_REGIONS) <= set(protocol.limits.f_pain_n) <= set(SEGMENT_PARTS)


def test_tasks_are_distinct_and_their_prompts_name_the_region(protocol: Protocol) -> None:
    assert protocol.tasks
    for field in ("id", "name", "prompt"):
        values = [getattr(task, field) for task in protocol.tasks]
        assert len(set(values)) == len(values), field
    for task in protocol.tasks:
        words = task.region.replace("_", " ")
        assert task.region in STANDARD_REGIONS
        assert task.action in task.prompt
        assert words in task.prompt
        assert task.name == f"{task.action.capitalize()} {words}"


def test_what_loading_does_not_check_is_in_order(protocol: Protocol) -> None:
    phases, contact, physics = protocol.phases, protocol.contact, protocol.physics
    assert phases.settle_hold_s < phases.settle_min_s
    assert physics.dt_s < physics.target_period_s
    for tissue in protocol.person.tissue.values():
        assert tissue.spacing_m <= tissue.coarse_spacing_m
        assert tissue.measured_depth_m < tissue.thickness_m
    assert max(contact.filter_hz, contact.peak_filter_hz) < 0.5 / physics.dt_s
    assert 2 * contact.stroke_filter_hz < contact.stroke_sample_hz


def test_in_the_protocol_of_the_paper_only_the_arm_changes() -> None:
    assert load_protocol("bathing-v3").variation == Variation()


# -- bathing-v3: what the written definition of the benchmark says ----------------------------------------------

BATHING = load_protocol("bathing-v3")


def test_bathing_tasks() -> None:
    assert [(t.id, t.action, t.region) for t in BATHING.tasks] == [
        ("T1", "touch", "forearm"),
        ("T2", "push", "forearm"),
        ("T3", "scrub", "forearm"),
        ("T4", "touch", "upper_arm"),
        ("T5", "scrub", "upper_arm"),
        ("T6", "touch", "abdomen"),
        ("T7", "scrub", "abdomen"),
    ]


def test_bathing_trials() -> None:
    assert BATHING.randomization.seeds == list(range(20))
    assert BATHING.randomization.comfort_arm_deg == (45.0, 60.0)
    phases = BATHING.phases
    assert (phases.settle_min_s, phases.settle_max_s) == (2, 10)
    assert (phases.settle_hold_s, phases.settle_speed_m_s) == (0.25, 0.01)
    assert (phases.time_limit_s, phases.truncation_over_pain) == (30.0, 2.0)
    assert (phases.first_call_deadline_s, phases.call_deadline_s) == (120.0, 30.0)


def test_bathing_rates() -> None:
    physics = BATHING.physics
    assert (1 / physics.dt_s, physics.target_period_s) == (500.0, 0.020)
    assert (physics.max_tcp_speed_m_s, physics.max_tcp_rotation_rad_s) == (0.25, 1.0)


def test_bathing_contact_definition() -> None:
    contact = BATHING.contact
    assert (contact.on_n, contact.off_n, contact.valid_total_s, contact.episode_gap_s) == (0.5, 0.25, 0.050, 1.0)
    assert (contact.filter_order, contact.filter_hz, contact.peak_filter_hz) == (2, 20.0, 100.0)
    assert (contact.stroke_sample_hz, contact.stroke_filter_hz, contact.reversal_m) == (50.0, 5.0, 0.010)
    assert (contact.active_speed_m_s, contact.active_rotation_rad_s) == (0.005, 0.05)


def test_bathing_neighbourhoods() -> None:
    assert {region: set(segments) for region, segments in BATHING.contact.neighbourhood.items()} == {
        "forearm": {"right_hand", "right_forearm", "right_upper_arm"},
        "upper_arm": {"right_forearm", "right_upper_arm", "thorax"},
        "abdomen": {"thorax", "abdomen", "pelvis"},
    }


def test_bathing_gates() -> None:
    gates = BATHING.gates
    assert gates.touch.duration_s == 0.5
    assert (gates.push.force_n, gates.push.duration_s, gates.push.wrist_displacement_m) == (3.0, 1.0, 0.020)
    assert (gates.scrub.on_share, gates.scrub.stroke_m, gates.scrub.extent_m) == (0.70, 0.100, 0.050)
    assert gates.scrub.reversals == 1
    assert gates.region_share == 0.80


@pytest.mark.parametrize(
    ("region", "gate_n", "cut_n"), [("forearm", 35.0, 200.0), ("upper_arm", 35.0, 200.0), ("abdomen", 21.0, 120.0)]
)
def test_bathing_force_limits(region: str, gate_n: float, cut_n: float) -> None:
    pain = BATHING.f_pain(REGIONS[region].segment)
    assert BATHING.limits.gamma * pain == pytest.approx(gate_n)
    assert BATHING.phases.truncation_over_pain * pain == pytest.approx(cut_n)


@pytest.mark.parametrize(("protocol", "touch_n", "push_n"), [("bathing-v3", 35, 35), ("bathing-wide-v2", 15, 25)])
def test_the_largest_force_of_a_trial_is_the_exams_where_that_is_less(
    protocol: str, touch_n: float, push_n: float
) -> None:
    rules = load_protocol(protocol, level="L2" if protocol == "bathing-wide-v2" else None)
    assert rules.most_n("touch", "right_forearm") == pytest.approx(touch_n)
    assert rules.most_n("push", "right_forearm") == pytest.approx(push_n)
    assert rules.most_n("push", "abdomen") == pytest.approx(21), "the safety gate is less"


def test_bathing_impedance() -> None:
    impedance = BATHING.impedance
    assert impedance.effective_mass_kg == 10.0
    assert impedance.translational_bounds == (100.0, 1000.0)
    assert impedance.rotational_bounds == (5.0, 50.0)


def test_bathing_scene() -> None:
    scene, exterior = BATHING.scene, BATHING.cameras["exterior"]
    assert (scene.mattress_top_m, scene.board_friction) == (0.62, 0.3)
    assert exterior.width * 9 == exterior.height * 16
    assert BATHING.cameras["bedside"].position_m[1] * scene.robot_base_m[1] < 0, "bedside looks from the other side"
    assert [name for name, camera in BATHING.cameras.items() if camera.mount == "hand"] == ["wrist"]


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
    own = load_protocol("bathing-v3").model_copy(update={"id": "mine-v1", "frozen": True})
    assert frozen_state(own).startswith("not verified as frozen: ")
    assert frozen_state(own.model_copy(update={"frozen": False})) == "draft"


def test_a_draft_is_one_and_an_earlier_recording_is_not_verified() -> None:
    draft = load_protocol("bathing-v3").model_copy(update={"id": "bathing-v4-draft", "frozen": False})
    assert frozen_state(draft) == "draft"
    assert frozen_state(softened(draft)) == "draft"
    earlier = draft.model_copy(update={"id": "bathing-v2", "frozen": True})
    assert frozen_state(earlier).startswith("not verified as frozen: ")
    assert drifted_sha256("bathing-v2", earlier.sha256) is None

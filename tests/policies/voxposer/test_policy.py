from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Callable
from dataclasses import replace
from importlib import resources
from pathlib import Path

import numpy as np
import pytest
from tools.freeze_completions import replay_lines

from carecontact.errors import ContractError, LanguageError, PolicyError, ProgramError
from carecontact.interface.action_spaces import check_action
from carecontact.interface.observation import Observation
from carecontact.interface.policy import Policy
from carecontact.interface.robot import Session
from carecontact.policies.motion import CAP_RADIUS_M
from carecontact.policies.voxposer import maps as fixed
from carecontact.policies.voxposer.maps import Grid
from carecontact.policies.voxposer.policy import Objective, Pursuit, VoxPoser, VoxPoserPhased, objective_functions
from carecontact.policies.voxposer.programs import SETS, VOXPOSER_PHASED
from carecontact.policies.voxposer.scene import gap, skin_height, touches
from carecontact.protocol.load import load_protocol
from carecontact.serving.conversation import PolicySetup
from carecontact.serving.process import PolicyProcess
from tests.interface.lying_person import Person, observe
from tests.policies.voxposer.conftest import scripted

PROMPTS = {task.id: task.prompt for task in load_protocol("bathing-v3").tasks}
MakeSession = Callable[..., Session]
BENIGN = {
    ("planner", "go"): 'composer("there")',
    ("composer", "there"): 'execute(parse_query_obj("gripper"), affordance_map=get_affordance_map("x"))',
    ("parse_query_obj", "gripper"): 'ret_val = detect("gripper")',
    ("get_affordance_map", "x"): "m = get_empty_affordance_map()\nset_voxel(m, (50, 50, 50), 1)\nret_val = m",
}


def follow(policy: VoxPoser, observation: Observation, *, looks: int = 60) -> tuple[np.ndarray, list[dict]]:
    """As if the arm followed perfectly: (n, 3) where it was sent, and the notes."""
    way, notes = [], []
    for _ in range(looks):
        actions = policy.act(observation)
        notes.append(policy.take_notes())
        poses = [a.pose_tcp_in_base for a in actions if a.pose_tcp_in_base is not None]
        way += [pose[:3] for pose in poses]
        if actions[-1].done:
            return np.array(way), notes
        observation = dataclasses.replace(observation, pose_tcp_in_base=poses[-1])
    raise AssertionError("never done")


def started(session: Session, programs: dict | None = None, instruction: str = "go") -> VoxPoser:
    policy = VoxPoser(language=None if programs is None else scripted(programs))
    policy.configure(session)
    policy.reset(instruction)
    return policy


def test_the_authored_programs_reach_their_region_and_come_back(
    observation: Observation, person: Person, session: MakeSession
) -> None:
    policy = started(session(), instruction=PROMPTS["T1"])
    way, notes = follow(policy, observation)
    assert person.clearance(way).min() < 0.01
    np.testing.assert_allclose(way[-1], observation.pose_tcp_in_base[:3], atol=1e-6)
    first = notes[0]
    assert first["language"][0]["backend"] == policy.card.language_backend
    assert policy.card.language_backend.endswith(":authored")
    assert first["cost_level"].shape == (fixed.MAP_SIZE, fixed.MAP_SIZE)
    assert len(first["path_px"]) == len(first["path_m"])
    assert first["written"]["velocity"][0][3:] == [10.0, 0.25]
    assert (first["path_speed_m_s"][0], first["path_speed_m_s"][-1]) == (fixed.FULL_SPEED_M_S, fixed.FULL_SPEED_M_S / 4)
    assert len(first["path_quat"]) == len(first["path_m"]) - 1
    assert {p["role"] for p in first["programs"]} >= {"planner", "composer", "get_affordance_map"}
    assert all("language" not in note for note in notes[1:]), "every program was asked for before anything moved"


@pytest.mark.parametrize("name", SETS)
def test_the_authored_completions_are_frozen_and_answer_every_task(
    name: str, observation: Observation, session: MakeSession
) -> None:
    folder = resources.files("carecontact.policies.voxposer") / "completions"
    content = (folder / f"{name}.jsonl").read_bytes()
    assert (folder / f"{name}.sha256").read_text().split() == [hashlib.sha256(content).hexdigest(), f"{name}.jsonl"]
    assert replay_lines((folder / f"{name}.toml").read_text(), SETS[name]).encode() == content, "make them again"


@pytest.mark.parametrize("task", PROMPTS)
def test_every_task_starts_with_a_valid_motion(observation: Observation, session: MakeSession, task: str) -> None:
    actions = started(session(), instruction=PROMPTS[task]).act(observation)
    assert 1 < len(actions) <= (fixed.HORIZON_S + fixed.SETTLE_S) * fixed.CONTROL_HZ
    for action in actions:
        check_action(action, session().action_bounds)


def test_a_person_who_is_not_there_is_not_looked_for_by_moving(session: MakeSession) -> None:
    policy = started(session(), instruction=PROMPTS["T1"])
    (action,) = policy.act(observe(None))
    assert (action.done, action.pose_tcp_in_base) == (True, None)
    assert "found in the image" in policy.take_notes()["ended_because"]


BAD = {
    "plans nothing": ({("planner", "go"): "x = 1"}, "composes nothing"),
    "plans without end": ({("planner", "go"): 'while True:\n    composer("there")'}, "at most 12 texts"),
    "plans nothing to do": ({("planner", "go"): 'composer("")'}, "expected a text of 1 to 300 characters, got ''"),
    "plans a blank": ({("planner", "go"): 'composer("  ")'}, "expected a text of 1 to 300 characters, got ' "),
    "plans a novel": (
        {("planner", "go"): 'composer("a" * 70000)'},
        "program planner: go .* 1 to 300 characters, got 'a",
    ),
    "asks a novel": (
        {("composer", "there"): 'get_affordance_map("b" * 301)'},
        "program composer: there .* 1 to 300 characters",
    ),
    "moves a limb by itself": (
        {
            ("composer", "there"): 'execute(parse_query_obj("right forearm"), affordance_map=get_affordance_map("x"))',
            ("parse_query_obj", "right forearm"): 'ret_val = detect("right forearm")',
        },
        "only the gripper moves by itself, not right forearm",
    ),
    "takes one map for another": (
        {("composer", "there"): 'execute(parse_query_obj("gripper"), velocity_map=get_affordance_map("x"))'},
        "velocity_map expects what get_velocity_map returns, or None; got affordance map",
    ),
    "moves a text": ({("composer", "there"): 'execute("gripper")'}, "only the gripper moves by itself, not str"),
    "gives a map twice": (
        {("composer", "there"): 'execute(parse_query_obj("gripper"), get_affordance_map("x"), affordance_map=None)'},
        r"^program composer: there was stopped: ValueError: execute: multiple values for argument 'affordance_map'; "
        r".* execute\(movable, affordance_map=None, ",
    ),
    "gives one map too many": (
        {("composer", "there"): 'execute(parse_query_obj("gripper"), None, None, None, None, None, None)'},
        r"ValueError: execute: too many positional arguments; .* execute.* \(line 1: execute\(parse_query_obj",
    ),
    "gives nothing under an unknown name": (
        {("composer", "there"): 'execute(parse_query_obj("gripper"), force_map=None)'},
        r"unexpected keyword argument 'force_map'; .* velocity_map=None, gripper_map=None\) \(line 1",
    ),
    "moves nothing": (
        {("composer", "there"): "x = 1"},
        "^program composer: there moves nothing: it calls neither execute nor reset_to_default_pose$",
    ),
    "goes home to somewhere": (
        {("composer", "there"): "reset_to_default_pose(1)"},
        r"TypeError: too many positional arguments; .* reset_to_default_pose\(\) \(line 1",
    ),
    "writes a map into a part": (
        {("get_affordance_map", "x"): 'set_voxel_by_radius(parse_query_obj("gripper"), (1, 2, 3))'},
        "expected a map from get_empty_..._map first, got gripper",
    ),
    "finds a part and a number": (
        {("parse_query_obj", "gripper"): 'ret_val = [detect("gripper"), 3]'},
        "leaves no part .* nor a list of parts",
    ),
    "asks for what is not known": ({("parse_query_obj", "gripper"): 'ret_val = detect("left foot")'}, "'left foot'"),
    "finds a number": ({("parse_query_obj", "gripper"): "ret_val = 3"}, "leaves no part"),
    "makes no map": ({("get_affordance_map", "x"): "ret_val = 1"}, "leaves no affordance map"),
    "writes nonsense": (
        {("get_affordance_map", "x"): 'm = get_empty_affordance_map()\nset_voxel(m, (1, 2), float("nan"))'},
        "expected 3 numbers",
    ),
    "writes for ever": (
        {("get_affordance_map", "x"): "m = get_empty_affordance_map()\nwhile True:\n    set_voxel(m, (1, 2, 3), 1)"},
        "at most 1000 entries",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_a_wrong_program_is_found_before_anything_moves(
    observation: Observation, session: MakeSession, name: str
) -> None:
    changed, fault = BAD[name]
    with pytest.raises(ProgramError, match=fault):
        started(session(), BENIGN | changed).act(observation)


def test_maps_may_be_given_in_the_releases_order_and_left_out(observation: Observation, session: MakeSession) -> None:
    programs = BENIGN | {
        ("get_velocity_map", "v"): "ret_val = set_voxel_by_radius(get_empty_velocity_map(), (50, 50, 50), 200, 0.5)",
        ("get_rotation_map", "r"): "ret_val = set_voxel(get_empty_rotation_map(), (50, 50, 50), (1, 0, 0, 0))",
    }
    calls = [
        'execute(hand, get_affordance_map("x"), None, get_rotation_map("r"), get_velocity_map("v"))',
        'execute(hand, affordance_map=get_affordance_map("x"), avoidance_map=None, rotation_map=get_rotation_map("r"), '
        'velocity_map=get_velocity_map("v"), gripper_map=None)',
    ]
    ways = []
    for call in calls:
        policy = started(session(), programs | {("composer", "there"): f'hand = parse_query_obj("gripper")\n{call}'})
        ways.append([a.pose_tcp_in_base for a in policy.act(observation)])
        assert policy.take_notes()["maps"] == {"affordance": "x", "rotation": "r", "velocity": "v"}
    np.testing.assert_array_equal(ways[0], ways[1])
    slow = np.linalg.norm(np.diff([pose[:3] for pose in ways[0]], axis=0), axis=1).max() * fixed.CONTROL_HZ
    assert slow <= 0.5 * fixed.FULL_SPEED_M_S + 1e-6


def test_what_the_releases_programs_leave_out_has_the_releases_values(
    observation: Observation, session: MakeSession
) -> None:
    code = """
both = parse_query_obj("both")
assert [part.name for part in both] == ["right wrist", "right elbow"]
assert both[0].aabb == (both[0].low, both[0].high)
assert get_ee_pos() == parse_query_obj("gripper").position
assert abs(index2cm(3) - (index2cm(1, "x") + index2cm(1, "y") + index2cm(1, "z"))) < 1e-9
ret_val = set_voxel_by_radius(get_empty_affordance_map(), (50, 50, 50))
"""
    programs = BENIGN | {
        ("get_affordance_map", "x"): code,
        ("parse_query_obj", "both"): 'ret_val = [detect("right wrist"), detect("right elbow")]',
    }
    policy = started(session(), programs)
    policy.act(observation)
    assert policy.take_notes()["target_voxels"] == [[50, 50, 50]]


def test_programs_that_call_each_other_for_too_long_are_stopped_and_kept(
    observation: Observation, session: MakeSession
) -> None:
    programs = BENIGN | {
        ("get_affordance_map", "x"): 'for _ in range(1900):\n    parse_query_obj("gripper")\nret_val = 1',
        ("parse_query_obj", "gripper"): 'x = 0\nfor k in range(100000):\n    x += k\nret_val = detect("gripper")',
    }
    policy = started(session(), programs)
    assert policy._sandbox is not None
    policy._sandbox.time.limit_s = 0.4
    with pytest.raises(ProgramError, match=r"was stopped: the programs of one step took more than 0\.4 s together"):
        policy.act(observation)
    codes = [row["code"] for row in policy.take_notes()["programs"]]
    assert programs["get_affordance_map", "x"] in codes


@pytest.mark.parametrize("written", ["", "set_voxel(m, (5, 5, 5), 0.9)"])
def test_a_map_without_a_full_value_has_nowhere_to_go(
    observation: Observation, session: MakeSession, written: str
) -> None:
    code = f"m = get_empty_affordance_map()\n{written}\nret_val = m"
    programs = BENIGN | {("get_affordance_map", "x"): code}
    with pytest.raises(ProgramError, match="no voxel of the affordance map of 'there' is 1"):
        started(session(), programs).act(observation)


def test_a_completion_that_is_missing_is_the_languages_failure(session: MakeSession) -> None:
    policy = VoxPoser()
    policy.configure(session())
    with pytest.raises(LanguageError, match="has no completion"):
        policy.reset("juggle")


def test_the_order_of_calls(session: MakeSession, observation: Observation) -> None:
    policy = VoxPoser()
    assert isinstance(policy, Policy)
    with pytest.raises(ContractError, match="before configure"):
        policy.reset(PROMPTS["T1"])
    policy.configure(session())
    with pytest.raises(ContractError, match="before reset"):
        policy.act(observation)


def test_a_hostile_program_ends_its_own_trial_and_is_kept(
    replay_file: Callable[[dict], Path], observation: Observation, session: MakeSession
) -> None:
    hostile = BENIGN | {("get_affordance_map", "x"): "ret_val = open('/etc/passwd').read()"}
    setup = replace(PolicySetup.of("voxposer"), language=f"replay:{replay_file(hostile)}")
    with PolicyProcess(setup, first_deadline_s=20, deadline_s=20) as process:
        process.start()
        process.reset("go", session())
        with pytest.raises(PolicyError, match="program get_affordance_map: x was stopped: PermissionError") as caught:
            process.act(observation)
    assert caught.value.kind == "program"
    assert hostile["get_affordance_map", "x"] in [row["code"] for row in caught.value.notes["programs"]]


DOWN = np.array([0.0, 1.0, 0.0, 0.0])
PLATE = np.array([(x, y, 0.1) for x in np.arange(0.3, 0.7, 0.004) for y in np.arange(-0.1, 0.1, 0.004)])
WALL = np.array([(0.5, y, z) for y in np.arange(-0.1, 0.1, 0.004) for z in np.arange(0.0, 0.2, 0.004)])
X = np.array([1.0, 0.0, 0.0])


def pose(*position: float) -> np.ndarray:
    return np.concatenate([position, DOWN])


def test_a_slide_goes_back_and_forth_under_the_skin_until_its_way_is_done(grid: Grid) -> None:
    slide = Objective(kind="slide", direction=X, distance_m=0.2, span_m=0.1)
    pursuit = Pursuit(objective=slide, skin=PLATE, start=np.array([0.5, 0.0, 0.098]))
    tool, ends = pose(0.5, 0.0, 0.098), []
    while (moved := pursuit.next_motion(tool, grid)) is not None:
        way = np.array([a.pose_tcp_in_base[:3] for a in moved.actions])
        assert way[-1, 2] == pytest.approx(0.1 - fixed.PRESS_M, abs=1e-6)
        speed = np.linalg.norm(np.diff(way, axis=0), axis=1).max() * fixed.CONTROL_HZ
        assert speed <= fixed.SLIDE_SPEED_M_S * 1.01
        tool = moved.actions[-1].pose_tcp_in_base
        ends.append(round(float(tool[0]), 3))
    assert ends == [0.55, 0.45, 0.55]
    assert pursuit.done_m == pytest.approx(0.25)


def test_a_slide_that_the_tool_does_not_follow_is_given_up(grid: Grid) -> None:
    slide = Objective(kind="slide", direction=X, distance_m=0.2, span_m=0.1)
    pursuit = Pursuit(objective=slide, skin=PLATE, start=np.array([0.5, 0.0, 0.098]))
    looks = 0
    while pursuit.next_motion(pose(0.5, 0.0, 0.098), grid) is not None:
        looks += 1
    assert (looks, pursuit.done_m) == (fixed.MAX_PROGRESS_LOOKS, 0)


def test_a_displacement_leads_further_ahead_the_longer_nothing_moves_and_holds_when_met(grid: Grid) -> None:
    push = Objective(kind="displace", direction=X, distance_m=0.04)
    start = np.array([0.5 - CAP_RADIUS_M - 0.01, 0.0, 0.1])
    pursuit = Pursuit(objective=push, skin=WALL, start=start)
    leads = []
    for _ in range(6):
        moved = pursuit.next_motion(pose(*start), grid)
        assert moved is not None
        leads.append(float(moved.actions[-1].pose_tcp_in_base[0] - start[0]))
    np.testing.assert_allclose(leads, [0.015, 0.03, 0.045, 0.06, 0.06, 0.06], atol=1e-9)
    assert pursuit.done_m == pytest.approx(-0.01, abs=1e-6), "the way to the skin does not count"
    held = pursuit.next_motion(pose(*(start + 0.055 * X)), grid)
    assert held is not None
    assert len(held.actions) == fixed.DISPLACE_HOLD_S * fixed.CONTROL_HZ
    ends = np.array([a.pose_tcp_in_base[:3] for a in held.actions if a.pose_tcp_in_base is not None])
    np.testing.assert_allclose(ends - start, np.tile(0.06 * X, (len(ends), 1)), atol=1e-9)
    assert pursuit.next_motion(pose(*(start + 0.055 * X)), grid) is None


def test_what_is_seen_tells_the_touch() -> None:
    assert touches(PLATE, np.array([0.5, 0.0, 0.104]))
    assert touches(PLATE, np.array([0.5, 0.0, 0.09]))
    assert not touches(PLATE, np.array([0.5, 0.0, 0.110]))
    assert gap(WALL, np.array([0.45, 0.0, 0.1]), X) == pytest.approx(0.05 - CAP_RADIUS_M)
    assert gap(WALL, np.array([0.45, 0.0, 0.1]), -X) == 0
    assert gap(WALL, np.array([0.495, 0.0, 0.1]), X) == 0
    assert skin_height(PLATE, np.array([0.5, 0.0, 0.3])) == pytest.approx(0.1)
    assert skin_height(PLATE, np.array([0.9, 0.0, 0.3])) == pytest.approx(0.3 + fixed.PRESS_M)


@pytest.mark.parametrize(
    ("call", "fault"),
    [
        (lambda f: f["slide"]((0, 0, 1), 20, 10), "length 0"),
        (lambda f: f["slide"]((1, 0, 0), 0, 10), "more than 0"),
        (lambda f: f["displace"]((1, 0, 0), 1e5), "at most 100 cm"),
        (lambda f: f["displace"]("x", 3), "expected 3 numbers"),
    ],
)
def test_what_is_no_objective(grid: Grid, call: Callable[[dict], object], fault: str) -> None:
    with pytest.raises((ValueError, TypeError), match=fault):
        call(objective_functions(grid))


def test_the_objective_takes_over_where_the_maps_have_arrived(
    observation: Observation, person: Person, session: Callable[..., Session]
) -> None:
    policy = VoxPoserPhased()
    policy.configure(session())
    prompt = next(t.prompt for t in load_protocol("bathing-v3").tasks if t.id == "T3")
    policy.reset(prompt)
    way, notes = follow(policy, observation)
    progress = [n["progress_m"] for n in notes if "progress" in n]
    assert progress[0] == 0
    assert progress[-1] >= 0.2
    assert [n["pursuing"] for n in notes if "progress" in n] == [True] * (len(progress) - 1) + [False]
    plans = [k for k, n in enumerate(notes) if "plan" in n]
    assert max(plans) < min(k for k, n in enumerate(notes) if "progress" in n)
    near = way[person.clearance(way) < 0.0]
    along = (near - person.elbow) @ (person.wrist - person.elbow) / np.linalg.norm(person.wrist - person.elbow)
    assert np.ptp(along) > 0.08


def test_progress_is_nothing_else(observation: Observation, session: Callable[..., Session]) -> None:
    code = 'execute(parse_query_obj("gripper"), affordance_map=get_affordance_map("x"), progress=get_progress("p"))'
    for code_of_role, fault in (("ret_val = 3", "leaves no objective"), ("ret_val = slide((1, 0, 0), 5)", "span_cm")):
        programs = BENIGN | {("composer", "there"): code, ("get_progress", "p"): code_of_role}
        policy = VoxPoserPhased(language=scripted(programs, VOXPOSER_PHASED))
        policy.configure(session())
        policy.reset("go")
        with pytest.raises(ProgramError, match=fault):
            policy.act(observation)

"""The log against a clock and known numbers."""

from __future__ import annotations

import hashlib
import json
from typing import Any

import numpy as np
import pytest

from carecontact.episode.episode import Episode
from carecontact.episode.log import MAX_NOTES, MAX_NOTES_BYTES, MAX_STEP_NOTES, SUMS, TrialLog
from carecontact.episode.looks import flags
from carecontact.errors import PolicyError
from carecontact.interface.action import Action
from carecontact.interface.geometry import matrix_from_quat
from carecontact.interface.observation import CameraView, Observation
from carecontact.interface.policy import PolicyCard
from carecontact.interface.regions import STANDARD_REGIONS
from carecontact.protocol.load import load_protocol
from carecontact.protocol.protocol import TrialSpec
from carecontact.recording import Recording
from carecontact.recording.pictures import MAX_FRAMES
from carecontact.recording.schema import ARRAYS, SEGMENTS, dimensions
from carecontact.scoring.online import NEEDED
from carecontact.sim.simulation import Samples

JOINTS = ["a", "b", "c"]
PERIOD_S, STEPS = 0.02, 10


class Clock:
    """Samples and values that are known functions of the time."""

    def __init__(self) -> None:
        self.steps = 0
        self.beside: tuple[np.ndarray, np.ndarray] | tuple[None, None] = (None, None)
        """What parts of the robot beside its tip do from now on."""

    @property
    def time_s(self) -> float:
        return self.steps * PERIOD_S / STEPS

    def advance(self, steps: int = STEPS) -> list[Samples]:
        time = (self.steps + np.arange(steps)) * PERIOD_S / STEPS
        self.steps += steps
        s = len(SEGMENTS)

        def ramp(*shape: int) -> np.ndarray:
            return np.broadcast_to(time.reshape(-1, *[1] * len(shape)), (steps, *shape)).copy()

        return [
            Samples(
                time_s=time,
                force=ramp(s, 3),
                normal=2 * ramp(s),
                centroid=3 * ramp(s, 3),
                beside_force=self.beside[0],
                beside_normal=self.beside[1],
                human_joint=4 * ramp(3),
                human_reaction=10 * ramp(3),
                tcp_pose=5 * ramp(7),
                tcp_speed=6 * time,
                tcp_rotation_speed=7 * time,
                wrist=8 * ramp(3),
                region_pose=9 * ramp(len(STANDARD_REGIONS), 7),
            )
        ]


CONSTANTS = {
    "scorer/human_joint_range": np.array([[-1.0, 1.0]] * 3),
    "scorer/human_joint_settled": np.array([0.1, 0.2, 0.3]),
    "scorer/wrist_settled_in_world": np.array([1.0, 2.0, 3.0]),
    "scorer/region_size_m": np.arange(9.0).reshape(3, 3),
}


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def log() -> TrialLog:
    return TrialLog(human_joints=len(JOINTS), regions=len(STANDARD_REGIONS), constants=CONSTANTS)


def add_period(log: TrialLog, clock: Clock, *blocks: int) -> None:
    """One period of the clock, in blocks of so many steps; keeps the state where the log wants one."""
    samples = [sample for steps in blocks or (STEPS,) for sample in clock.advance(steps)]
    now = clock.time_s
    row = {
        "scorer/period_time_s": now,
        "scorer/indentation_m": np.full(len(STANDARD_REGIONS), now / 100),
        "scorer/target_in_base": np.full(7, now),
    }
    log.add_period(samples, row)
    if log.wants_state(now):
        log.add_state(now, np.array([now, 1.0, 2.0]))


def row(pose: float | np.ndarray = np.nan, stiffness: tuple[float, float] = (400.0, 20.0)) -> dict[str, np.ndarray]:
    return {"actions/pose_tcp_in_base": np.full(7, pose), "actions/stiffness": np.array(stiffness)}


def observation(time: float, **images: Any) -> Observation:
    view = CameraView(intrinsics=np.eye(3), pose_camera_in_base=np.eye(4), **images)
    arm = {name: np.zeros(7) for name in ("joint_position", "joint_velocity", "pose_tcp_in_base")}
    cameras = {"overhead": view, "wrist": view}
    return Observation(instruction="touch", sim_time_s=time, gripper_position=np.zeros(1), cameras=cameras, **arm)


def sha(text: str) -> bytes:
    return hashlib.sha256(text.encode()).digest()


def assert_fits_the_schema(arrays: dict[str, np.ndarray]) -> None:
    sizes: dict[str, int] = {"S": len(SEGMENTS), "J": len(JOINTS), "R": len(STANDARD_REGIONS)}
    for path, (dtype, _) in ARRAYS.items():
        array, names = arrays[path], dimensions(path)
        assert array.dtype == np.dtype(dtype).newbyteorder("<"), path
        assert array.ndim == len(names), path
        for got, name in zip(array.shape, names, strict=True):
            assert got == (int(name) if name.isdecimal() else sizes.setdefault(name, got)), path


def test_an_empty_trial_has_every_array(log: TrialLog) -> None:
    arrays = log.arrays()
    assert_fits_the_schema(arrays)
    assert {len(arrays[p]) for p in ARRAYS if dimensions(p)[0] in "TPAMK"} == {0}
    assert set(arrays) == set(ARRAYS)


def test_a_full_trial_fits_the_schema(clock: Clock, log: TrialLog) -> None:
    for k in range(3):
        log.add_observation(observation(clock.time_s), sha(str(k)))
        log.add_action(clock.time_s, row(float(k)))
        add_period(log, clock)
    arrays = log.arrays()
    assert_fits_the_schema(arrays)
    assert set(arrays) == {*ARRAYS, "scorer/human_joint_reaction"}
    assert len(arrays["scorer/time_s"]) == 3 * STEPS
    assert len(arrays["scorer/period_time_s"]) == 3


def test_each_stream_goes_to_its_own_array_in_the_order_of_time(clock: Clock, log: TrialLog) -> None:
    """Also in several blocks, and where the arrays were read before."""
    for blocks in ((), (3, 7), (), ()):
        add_period(log, clock, *blocks)
        assert len(log.arrays()["scorer/time_s"]) == clock.steps
    arrays = log.arrays()
    ends = np.array([0.02, 0.04, 0.06, 0.08])
    np.testing.assert_allclose(arrays["scorer/period_time_s"], ends)
    np.testing.assert_allclose(arrays["scorer/indentation_m"], np.outer(ends / 100, [1, 1, 1]), rtol=1e-6)
    np.testing.assert_allclose(arrays["scorer/target_in_base"], np.outer(ends, np.ones(7)), rtol=1e-6)
    time = np.arange(4 * STEPS) * PERIOD_S / STEPS
    np.testing.assert_allclose(arrays["scorer/time_s"], time, atol=1e-12)
    paths = [
        *("force_human_from_robot_in_world", "normal_force", "centroid_in_world", "human_joint_position"),
        *("pose_tcp_in_world", "tcp_speed", "tcp_rotation_speed", "wrist_in_world", "region_pose_in_world"),
        "human_joint_reaction",
    ]
    for factor, path in enumerate(paths, start=1):
        array = arrays[f"scorer/{path}"]
        expected = np.broadcast_to((factor * time).reshape(-1, *[1] * (array.ndim - 1)), array.shape)
        np.testing.assert_allclose(array, expected, rtol=1e-6, err_msg=path)


def test_constants_and_extra_arrays_are_in_the_recording(log: TrialLog) -> None:
    log.extra["wall/act_s"] = np.array([0.1, 0.2])
    arrays = log.arrays()
    assert arrays["wall/act_s"].tolist() == [0.1, 0.2]
    for path, array in CONSTANTS.items():
        np.testing.assert_array_equal(arrays[path], array)


def test_states_are_kept_once_a_second(clock: Clock, log: TrialLog) -> None:
    for _ in range(160):
        add_period(log, clock)
    arrays = log.arrays()
    np.testing.assert_allclose(arrays["state/time_s"], [0.02, 1.02, 2.02, 3.02])
    np.testing.assert_array_equal(arrays["state/integration"][:, 0], arrays["state/time_s"])


def test_a_state_that_is_there_counts_for_its_second(clock: Clock, log: TrialLog) -> None:
    log.add_state(clock.time_s, np.zeros(3))
    add_period(log, clock)
    assert log.arrays()["state/time_s"].tolist() == [0.0]


def test_observations_keep_time_and_the_hash_of_what_was_sent(log: TrialLog) -> None:
    for k, time in enumerate((0.0, 0.1, 0.2)):
        log.add_observation(observation(time), sha(str(k)))
    arrays = log.arrays()
    assert arrays["policy/observation_time_s"].tolist() == [0.0, 0.1, 0.2]
    assert [bytes(row) for row in arrays["policy/observation_sha256"]] == [sha("0"), sha("1"), sha("2")]


def test_actions_name_the_observation_they_answer(clock: Clock, log: TrialLog) -> None:
    log.add_observation(observation(0.0), sha("0"))
    log.add_action(clock.time_s, row(np.arange(7.0)))
    add_period(log, clock)
    log.add_action(clock.time_s, row())
    add_period(log, clock)
    log.add_observation(observation(0.04), sha("1"))
    log.add_action(clock.time_s, row(stiffness=(100.0, 5.0)))
    arrays = log.arrays()
    assert arrays["actions/observation_index"].tolist() == [0, 0, 1]
    np.testing.assert_allclose(arrays["actions/time_s"], [0.0, 0.02, 0.04])
    assert arrays["actions/pose_tcp_in_base"][0].tolist() == list(range(7))
    assert np.isnan(arrays["actions/pose_tcp_in_base"][1:]).all()
    assert arrays["actions/stiffness"].tolist() == [[400, 20], [400, 20], [100, 5]]


def test_frames_are_stored_by_observation_camera_and_modality(log: TrialLog) -> None:
    rgb, depth = np.full((2, 3, 3), 7, np.uint8), np.full((2, 3), 0.5, np.float32)
    log.add_observation(observation(0.0), sha("0"))
    log.add_observation(observation(0.1, rgb=rgb, depth=depth), sha("1"))
    frames = {p: a for p, a in log.arrays().items() if p.startswith("policy/frames/")}
    assert set(frames) == {
        f"policy/frames/0001/{camera}/{modality}" for camera in ("overhead", "wrist") for modality in ("rgb", "depth")
    }
    np.testing.assert_array_equal(frames["policy/frames/0001/wrist/rgb"], rgb)
    np.testing.assert_array_equal(frames["policy/frames/0001/overhead/depth"], depth)


def test_the_frames_of_a_step_that_failed_are_no_observation(log: TrialLog) -> None:
    """Its notes stand beside them, so that they can be drawn."""
    rgb = np.full((2, 3, 3), 7, np.uint8)
    log.add_frames(observation(0.0, rgb=rgb))
    log.add_notes({"options": []}, failed=True)
    arrays = log.arrays()
    np.testing.assert_array_equal(arrays["policy/frames/0000/overhead/rgb"], rgb)
    assert "policy/notes/0000/json" in arrays
    assert len(arrays["policy/observation_time_s"]) == 0


def test_the_first_frames_are_kept_as_they_are_and_the_later_ones_as_a_film(log: TrialLog) -> None:
    rgb = np.zeros((2, 3, 3), np.uint8)
    count = MAX_FRAMES // 2 + 5
    for k in range(count):
        log.add_observation(observation(k / 10, rgb=rgb), sha(str(k)))
    arrays = log.arrays()
    kept = sorted({p.split("/")[2] for p in arrays if p.startswith("policy/frames/")})
    assert kept == [f"{k:04d}" for k in range(MAX_FRAMES // 2)]
    for camera in ("overhead", "wrist"):
        filmed = arrays[f"policy/film/{camera}/rgb/observation_index"]
        assert filmed.tolist() == list(range(MAX_FRAMES // 2, count))
    assert len(arrays["policy/observation_sha256"]) == count


def test_which_cameras_took_a_view_is_kept_only_where_one_has_a_rate(log: TrialLog) -> None:
    log.add_observation(observation(0.0), sha("0"), looked=flags(["wrist"]))
    assert log.arrays()["policy/looked"].tolist() == [[0, 0, 0, 1]]


def test_notes_are_kept_beside_their_observation(log: TrialLog) -> None:
    for k in range(2):
        log.add_observation(observation(0.0), sha(str(k)))
    log.add_notes({"chosen": 2, "map": np.eye(2, dtype=np.float32)})
    log.add_notes({})
    arrays = log.arrays()
    assert json.loads(arrays["policy/notes/0001/json"].tobytes()) == {"chosen": 2}
    np.testing.assert_array_equal(arrays["policy/notes/0001/map"], np.eye(2))
    assert set(arrays) - set(ARRAYS) == {"policy/notes/0001/json", "policy/notes/0001/map"}


@pytest.mark.parametrize(
    ("notes", "kind"),
    [
        ({"a": [np.zeros(2)]}, "garbage"),
        ({"json": np.zeros(2), "chosen": 2}, "garbage"),
        ({"a": np.zeros(MAX_NOTES_BYTES // 8)}, "oversize"),
    ],
)
def test_notes_that_cannot_be_kept_are_the_policys_failure(log: TrialLog, notes: dict[str, Any], kind: str) -> None:
    with pytest.raises(PolicyError) as caught:
        log.add_notes(notes)
    assert caught.value.kind == kind


def test_too_many_notes_are_the_policys_failure_however_empty(log: TrialLog) -> None:
    """4,090 empty arrays at each of five steps took 153 s to write."""
    with pytest.raises(
        PolicyError, match=f"at most {MAX_STEP_NOTES} entries a step, got {MAX_STEP_NOTES + 1}"
    ) as caught:
        log.add_notes({f"a{k:04d}": np.zeros(0) for k in range(MAX_STEP_NOTES + 1)})
    assert caught.value.kind == "oversize"
    for _ in range(MAX_NOTES // (MAX_STEP_NOTES + 1)):
        log.add_notes({f"a{k:04d}": np.zeros(0) for k in range(MAX_STEP_NOTES)})
    with pytest.raises(PolicyError, match=f"notes of more than {MAX_NOTES} arrays in one trial") as caught:
        log.add_notes({f"a{k:04d}": np.zeros(0) for k in range(MAX_STEP_NOTES)})
    assert caught.value.kind == "oversize"


# What the declared cells of the target region felt is in every recording.

CARD = PolicyCard(name="press", modalities=(), cameras=(), control_hz=10)
FOREARM = SEGMENTS.index("right_forearm")


@pytest.fixture(scope="module")
def press() -> Recording:
    """Down onto the forearm's middle and 30 mm along it."""
    with Episode(
        TrialSpec(protocol=load_protocol("bathing-v3"), task_id="T1", seed=0, policy="press"), card=CARD
    ) as episode:
        first = episode.reset()
        site = episode.simulation.data.site("region_forearm")
        along, outward = site.xmat.reshape(3, 3)[:, 0], np.array([0.0, 0.0, 1.0])
        base = episode.simulation.pose_base_in_world
        for k in range(45):
            height, way = (0.15, 0.0) if k < 25 else (0.02, 0.0 if k < 35 else 0.003 * (k - 34))
            goal = site.xpos + height * outward + way * along
            pose = first.pose_tcp_in_base.copy()
            pose[:3] = matrix_from_quat(base[3:]).T @ (goal - base[:3])
            episode.step(Action(pose_tcp_in_base=pose, done=k == 44), observe=False)
        return episode.finish()


def test_the_sums_over_the_cells_are_those_of_the_whole_region(press: Recording) -> None:
    dt_s = press.header.spec.protocol.physics.dt_s
    normal = press["scorer/normal_force"][:, FOREARM].astype(float)
    assert normal.max() > 1.0
    steps = round(press.header.spec.protocol.physics.target_period_s / dt_s)
    impulse = normal.reshape(-1, steps).sum(1) * dt_s
    np.testing.assert_allclose(press["scorer/cell_press_ns"].sum(1), impulse, rtol=1e-4, atol=1e-6)
    free = normal.reshape(-1, steps).max(1) == 0
    assert free.any()
    for path in SUMS:
        assert press[path].dtype == np.float32
        assert (press[path] >= 0).all()
        assert press[path][free].max() == 0
        assert press[path][~free].max() > 0


def test_the_cells_lie_on_the_region_and_those_under_the_tool_are_pressed(press: Recording) -> None:
    length, _, radius = press["scorer/region_size_m"][press.header.regions.index("forearm")]
    centres, area = press["scorer/cell_in_region"], press["scorer/cell_area_m2"]
    assert np.abs(centres[:, 0]).max() < length / 2
    assert centres[:, 2].max() == pytest.approx(radius, abs=0.015)
    assert 0 < area.min() <= area.max() < 0.020**2
    last = press["scorer/cell_press_ns"][-1]
    pose = press["scorer/region_pose_in_world"][-1, press.header.regions.index("forearm")].astype(float)
    tool = matrix_from_quat(pose[3:]).T @ (press["scorer/pose_tcp_in_world"][-1, :3] - pose[:3])
    assert np.linalg.norm(last @ centres / last.sum() - tool) < 0.012


def test_what_progress_needs_is_the_same_whenever_it_is_gathered() -> None:
    """Streams grow from call to call, also those that begin late because only the tip touched at first."""
    clock = Clock()
    often, once = (TrialLog(human_joints=3, regions=len(STANDARD_REGIONS), constants={}) for _ in range(2))
    for number in range(9):
        if number == 4:
            beside = np.random.default_rng(0).normal(size=(STEPS, 2, len(SEGMENTS), 3))
            clock.beside = beside, beside[..., 0]
        samples = clock.advance()
        for log in (often, once):
            log.add_period(samples, {})
        if number != 2:
            often.measured(NEEDED)
    found, whole = often.measured(NEEDED), once.arrays()
    beside_paths = {"scorer/beside_force_in_world", "scorer/beside_normal_force"}
    assert found.keys() >= {*NEEDED, *beside_paths}
    for path in (*NEEDED, *beside_paths):
        np.testing.assert_array_equal(found[path], whole[path])
        assert found[path].dtype == whole[path].dtype
    assert not found["scorer/beside_force_in_world"][: 4 * STEPS].any()


def test_the_mean_force_is_that_of_the_last_steps() -> None:
    clock, log = Clock(), TrialLog(human_joints=3, regions=len(STANDARD_REGIONS), constants={})
    assert not log.measures
    assert not log.mean_force(5).any()
    for _ in range(3):
        log.add_period(clock.advance(), {})
    assert log.measures
    # The force at step k is k times the time step.
    assert log.mean_force(15)[0, 0] == pytest.approx(PERIOD_S / STEPS * np.arange(15, 30).mean())
    assert log.mean_force(1000)[0, 0] == pytest.approx(PERIOD_S / STEPS * np.arange(30).mean())

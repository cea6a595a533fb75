"""What LIBERO's and Bridge's checkpoints are sent, against their own code and against scipy; addresses that exclude
each other; answers in another convention."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from carecontact.errors import ActionError, ConfigError, PolicyError
from carecontact.interface.deltas import DELTAS
from carecontact.interface.observation import CameraView, Observation
from carecontact.interface.policy import PolicyRef
from carecontact.protocol.load import load_protocol
from carecontact.serving.cartesian import ORIENTATIONS, SETUPS, bridge_state, libero_state, simpler_state
from carecontact.serving.dialect import PROFILES, card_of, check_options, profile_of
from carecontact.serving.dialect_media import delta_actions, setup_picture
from carecontact.serving.openpi import infer_request
from carecontact.sim.controllers import _arm_alone
from carecontact.sim.impedance import tcp_pose_in_base
from tests.serving.delta_servers import LIBERO_SPEC, OnOpenpi, OnVlaEval, robosuite_quat2mat
from tests.serving.fakes import Fake, policy_at, seen, talk

LIBERO_POSTURE = [0, -1.61037389e-01, 0.00, -2.44459747e00, 0.00, 2.22675220e00, np.pi / 4]
"""init_qpos of libero/libero/envs/robots/mounted_panda.py."""
LIBERO_PLACE = [-0.20846, 0.0, 1.17328]
"""robot0_eef_pos in that posture, in the scenes with a table."""
TURNS = [Rotation.from_euler("xyz", [180 + a, b, c], degrees=True) for a, b, c in [(0, 0, 0), (9, 4, 30), (-9, 7, -80)]]


def looking(turn: Rotation, *, opening: float) -> Observation:
    pose = np.array([0.4, -0.1, 0.3, *turn.as_quat(scalar_first=True)])
    return replace(seen(), pose_tcp_in_base=pose, gripper_position=np.array([opening]))


def test_in_liberos_first_posture_the_state_is_liberos() -> None:
    protocol = load_protocol("bathing-v3")
    arm = _arm_alone(protocol)
    data = mujoco.MjData(arm)
    data.qpos[:] = LIBERO_POSTURE
    mujoco.mj_kinematics(arm, data)
    pose = tcp_pose_in_base(arm, data, protocol.scene.robot)
    state = libero_state(replace(seen(), pose_tcp_in_base=pose, gripper_position=np.array([0.5])))
    # The two hands differ by half a millimetre along the last link, whose axis leans by 3 degrees.
    np.testing.assert_allclose(state[:3], LIBERO_PLACE, atol=1e-4)
    assert state[3] == pytest.approx(np.pi, abs=0.01)
    np.testing.assert_allclose(state[6:], [0.02, -0.02])


@pytest.mark.parametrize("turn", TURNS)
def test_states(turn: Rotation) -> None:
    shown = looking(turn, opening=1.0)
    libero, cut = libero_state(shown), libero_state(shown, shortest=True)
    assert (robosuite_quat2mat(libero[3:6]) * turn.inv()).magnitude() < 1e-9
    assert libero[3] > 0, "no jump by a whole turn about a tool that points down"
    np.testing.assert_allclose(cut[3:6], turn.as_rotvec(), atol=1e-9)
    np.testing.assert_array_equal(libero[6:], [0.04, -0.04])
    down = np.array([[0, 0, 1.0], [0, 1.0, 0], [-1.0, 0, 0]])
    # A tool that points down has no angles; its x axis, out of the tool, is our z axis.
    bridge, simpler = bridge_state(shown), simpler_state(shown)
    theirs = Rotation.from_euler("xyz", bridge[3:6]) * Rotation.from_matrix(down)
    np.testing.assert_allclose(theirs.as_matrix()[:, 0], turn.as_matrix()[:, 2], atol=1e-9)
    np.testing.assert_allclose(theirs.as_matrix()[:, 2], turn.as_matrix()[:, 0], atol=1e-9)
    np.testing.assert_array_equal(bridge[[0, 1, 2, 6, 7]], [0.4, -0.1, 0.3, 0, 1])
    assert (Rotation.from_quat(simpler[3:7], scalar_first=True) * theirs.inv()).magnitude() < 1e-9
    np.testing.assert_array_equal(simpler[[0, 1, 2, 7]], [0.4, -0.1, 0.3, 1])


def corners(height: int, width: int, aspect: tuple[int, int]) -> CameraView:
    """Red top left, green top right, blue bottom left of the part of an aspect, white beyond it."""
    rgb = np.full((height, width, 3), 255, np.uint8)
    high, wide = min(height, width * aspect[1] // aspect[0]), min(width, height * aspect[0] // aspect[1])
    part = rgb[(height - high) // 2 :, (width - wide) // 2 :][:high, :wide]
    part[:] = 90
    for (y, x), channel in {(0, 0): 0, (0, 1): 1, (1, 0): 2}.items():
        part[y * high // 2 : (y + 1) * high // 2, x * wide // 2 : (x + 1) * wide // 2][..., channel] = 220
    return CameraView(intrinsics=np.eye(3), pose_camera_in_base=np.eye(4), rgb=rgb)


@pytest.mark.parametrize("name", SETUPS)
@pytest.mark.parametrize(
    ("orientation", "order"),
    [("upright", "rgb."), ("mirrored", "gr.b"), ("upside-down", "b.rg"), ("turned", ".bgr")],
)
def test_pictures_are_cut_turned_and_resized(name: str, orientation: str, order: str) -> None:
    setup = SETUPS[name]
    shown = replace(seen(), cameras={"exterior": corners(360, 640, setup.aspect)})
    picture = setup_picture(shown, "exterior", setup, orientation=orientation, hw=(224, 224))
    assert picture.shape == (224, 224, 3)
    assert picture.max() < 250, "a part beyond the aspect is left"
    found = "".join("rgb."[[*(picture[y, x] > 160), True].index(True)] for y in (56, 168) for x in (56, 168))
    assert found == order


def test_an_orientation_is_the_one_of_its_name() -> None:
    """LIBERO's: what robosuite hands out, whose lowest row is first, turned by 180 degrees."""
    picture = np.arange(12, dtype=np.uint8).reshape(2, 2, 3)
    handed_out = picture[::-1]
    np.testing.assert_array_equal(ORIENTATIONS[SETUPS["libero"].orientation](picture), handed_out[::-1, ::-1])
    assert SETUPS["bridge"].orientation == "upright"


@pytest.mark.parametrize("name", SETUPS)
def test_a_request_has_exactly_its_keys_and_the_card_makes_it_again(name: str) -> None:
    profile = replace(PROFILES[name], orientation="turned", horizon=3)
    card = card_of(profile)
    assert profile_of(card.arguments) == profile
    assert (card.delta, card.control_hz) == (SETUPS[name].deltas, SETUPS[name].control_hz)
    request = infer_request(seen(), profile, session_id="")
    assert tuple(request) == profile.keys
    assert tuple(card.cameras) == (("exterior", "wrist") if name == "libero" else ("exterior",))


@pytest.mark.parametrize(
    ("address", "says"),
    [
        ("openpi://h:1?profile=libreo", "no profile named 'libreo'.*libero"),
        ("openpi://h:1?profile=libero&exterior=1", "exterior: the pictures of the profile libero have no number"),
        ("openpi://h:1?profile=libero&orientation=mirror", "no orientation named 'mirror'.*valid: upright, mirrored"),
        ("openpi://h:1?profile=pi05-droid&orientation=turned", "the profile pi05-droid has upright pictures"),
        ("openpi://h:1?orientation=turned", "orientation: only the profiles libero, bridge take it"),
        ("vla-eval://h:1?profile=pi05-droid", "no profile named 'pi05-droid'.*valid: libero, bridge"),
        ("vla-eval://h:1?space=joint_position&profile=libero", "space: the profile libero says that the actions are"),
        ("vla-eval://h:1?orientation=turned", "orientation: only the profiles libero, bridge take it"),
    ],
)
def test_an_address_that_means_nothing_is_refused_before_anything_is_connected(address: str, says: str) -> None:
    with pytest.raises(ConfigError, match=says):
        check_options(PolicyRef.parse(address))


@pytest.mark.parametrize(
    ("profile", "part", "form", "named"),
    [
        ("libero", "rotation", "euler_xyz", r"rotation \(3 of 'euler_xyz'\).*rotation axis_angle,"),
        ("libero", "gripper", "binary_close_negative", r"gripper \(3 of 'binary_close_negative'\)"),
        ("libero", "gripper", "continuous_01", "gripper binary_close_positive or raw"),
        ("bridge", "gripper", "binary_close_01", r"gripper \(3 of 'binary_close_01'\)"),
        ("bridge", "position", "absolute_xyz", "position delta_xyz"),
        ("bridge", "base_motion", "delta_xyz", r"base_motion \(3 of"),
    ],
)
def test_a_spec_that_contradicts_the_profile_is_named(profile: str, part: str, form: str, named: str) -> None:
    server = OnVlaEval(payload={"action_spec": LIBERO_SPEC | {part: {"dims": 3, "format": form}}})
    with server.running() as port, pytest.raises(PolicyError, match=named) as caught:
        talk(f"vla-eval://127.0.0.1:{port}?profile={profile}")
    assert caught.value.kind == "handshake"


@pytest.mark.parametrize(
    "spec", [{}, {"actions": {"dims": 0, "format": "raw"}}, {"gripper": LIBERO_SPEC["gripper"]}, LIBERO_SPEC]
)
def test_what_vla_evals_servers_say_fits_libero(spec: dict[str, object]) -> None:
    """No spec, and those of its pi0.py, starvla.py and openvla.py; the last one asks for a seed, too."""
    server = OnVlaEval(payload={"action_spec": spec, "observation_params": {"seed": 0}})
    with server.running() as port, policy_at(f"vla-eval://127.0.0.1:{port}?profile=libero") as policy:
        card = policy.start()
    assert (card.name, card.delta, card.cameras) == ("vla-eval libero", "osc", ("exterior",))


@pytest.mark.parametrize(
    ("wanted", "says"),
    [
        ({"absolute_action": True}, "the server asks for absolute_action"),
        ({"send_wrist_image": True}, "no wrist camera"),
    ],
)
def test_a_request_for_what_a_profile_lacks_is_refused(wanted: dict[str, object], says: str) -> None:
    server = OnVlaEval(payload={"observation_params": wanted})
    with server.running() as port, pytest.raises(PolicyError, match=says):
        talk(f"vla-eval://127.0.0.1:{port}?profile=bridge")


def test_numbers_beyond_a_bound_are_moved_onto_it_and_the_gripper_is_checked() -> None:
    rows = np.array([[1.7, -0.2, 0, 0, 0, -9, 1.2], [0, 0, 0, 0.5, 0, 0, -1.0]], np.float32)
    actions = delta_actions(rows, horizon=None, convention=DELTAS["osc"])
    np.testing.assert_allclose(
        [action.delta for action in actions if action.delta is not None], [[1, -0.2, 0, 0, 0, -1], [0, 0, 0, 0.5, 0, 0]]
    )
    assert all(action.gripper is None for action in actions)
    for bad, says in [
        (rows[:, :6], r"\(steps, 7\): three of translation, .* the gripper's column is missing"),
        (np.c_[rows, rows[:, :1]], "columns from number 8 on have no meaning here"),
        (rows * np.nan, "expected finite numbers"),
        (rows * 9, r"expected a gripper command of -1 \(open\) to 1 \(closed\) in the last column, got 10.8"),
    ]:
        with pytest.raises(ActionError, match=says):
            delta_actions(bad, horizon=None, convention=DELTAS["osc"])
    with pytest.raises(ActionError, match=r"expected a gripper command of 1 \(open\) to 0 \(closed\) .* got -1"):
        delta_actions(rows, horizon=None, convention=DELTAS["bridge"])
    with pytest.raises(ActionError, match="at least 5 steps, the horizon, got 2; add horizon=2"):
        delta_actions(rows, horizon=5, convention=DELTAS["osc"])


def test_metadata_of_a_joint_policy_contradict_a_profile_of_deltas() -> None:
    server: Fake = OnOpenpi(metadata={"action_space": "joint_velocity"})
    with (
        server.running() as port,
        pytest.raises(PolicyError, match="'joint_velocity' in the server's metadata and 'cart"),
    ):
        talk(f"openpi://127.0.0.1:{port}?profile=libero")

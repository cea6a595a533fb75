"""Do the angles mean what a clinic means by them? Forward kinematics by scipy, independent of the simulator."""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from carecontact.human.body import PARENT, Body
from carecontact.human.joints import Hinge, elbow_axis, hand_axes, hinges, supination_of
from carecontact.human.pose import FIXED_SEGMENTS, axis_rotation, lying_pose_deg, rotation_from_bind
from carecontact.human.skeleton import body_name
from carecontact.interface.geometry import matrix_from_quat
from carecontact.world.scene import Scene

FRONT, UP = np.array([0.0, -1.0, 0.0]), np.array([0.0, 0.0, 1.0])
SIDES = ("left", "right")
ARM = tuple(f"upper_arm_{motion}" for motion in ("abduction", "flexion", "rotation"))
ARM += ("forearm_flexion", "forearm_supination", "hand_flexion", "hand_deviation")
LEG = ("thigh_flexion", "thigh_abduction", "thigh_rotation", "shank_flexion", "foot_plantarflexion")


class Posed:
    """A body with some hinges at given anatomical angles [deg]; the rest stay in the bind pose."""

    def __init__(self, body: Body, angles: dict[str, float]) -> None:
        self.body, self.rotation, self.origin = body, {}, {}
        rows = hinges(body)
        unknown = set(angles) - {row.name for row in rows}
        assert not unknown
        for segment in body.segments:
            own = Rotation.identity()
            for row in rows:
                if row.segment == segment and row.name in angles:
                    own = own * Rotation.from_rotvec(np.radians(angles[row.name] - row.bind_deg) * row.axis)
            parent = PARENT[segment]
            if parent is None:
                self.rotation[segment], self.origin[segment] = own, body.joint_centre[segment]
            else:
                step = body.joint_centre[segment] - body.joint_centre[parent]
                self.rotation[segment] = self.rotation[parent] * own
                self.origin[segment] = self.origin[parent] + self.rotation[parent].apply(step)

    def turned(self, segment: str, vector: np.ndarray) -> np.ndarray:
        """A vector fixed to a segment, given in the bind pose."""
        return self.rotation[segment].apply(vector)

    def along(self, segment: str) -> np.ndarray:
        return self.turned(segment, self.body.direction(segment))

    def point(self, segment: str, bind_point: np.ndarray) -> np.ndarray:
        return self.origin[segment] + self.turned(segment, bind_point - self.body.joint_centre[segment])

    def toes(self, side: str) -> np.ndarray:
        foot = self.body.vertices_of(f"{side}_foot")
        return self.turned(f"{side}_foot", foot[foot[:, 1].argmin()] - self.body.joint_centre[f"{side}_foot"])


Pose = Callable[..., Posed]


@pytest.fixture(params=SIDES)
def side(request: pytest.FixtureRequest) -> str:
    return request.param


@pytest.fixture
def outward(side: str) -> np.ndarray:
    """Away from the mid-line."""
    return np.array([1.0 if side == "left" else -1.0, 0.0, 0.0])


@pytest.fixture
def limb(body: Body, side: str) -> Pose:
    """Poses one side: every hinge of arm and leg at zero but those named."""

    def posed(**angles: float) -> Posed:
        return Posed(body, {f"{side}_{n}": angles.get(n, 0.0) for n in (*ARM, *LEG)})

    return posed


def degrees_between(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.degrees(np.arccos(np.clip(a @ b / np.linalg.norm(a) / np.linalg.norm(b), -1, 1))))


def test_bind_pose_is_inside_every_range(body: Body) -> None:
    for row in hinges(body):
        assert row.range_deg[0] <= row.bind_deg <= row.range_deg[1], row.name
        # The old elbow does not quite straighten.
        assert row.range_deg[0] <= (4 if body.age_group == "old" and "forearm_flexion" in row.name else 0), row.name
        assert row.range_deg[1] > 0


def test_lying_pose_is_inside_every_range(body: Body) -> None:
    rows = {row.name: row for row in hinges(body)}
    for comfort in (45.0, 60.0):
        for name, angle in lying_pose_deg(body, comfort).items():
            low, high = rows[name].range_deg
            # The passive limits must not push at rest: a few degrees to either end.
            assert low + 5 <= angle <= high - 5, name


def test_hinges_are_unique_passive_and_on_unit_axes(body: Body) -> None:
    rows = hinges(body)
    assert len({row.name for row in rows}) == len(rows)
    for row in rows:
        assert row.name.startswith(row.segment + "_")
        assert np.linalg.norm(row.axis) == pytest.approx(1)
        assert row.stiffness_nm_rad > 0
        assert row.damping_nms_rad > 0
        assert row.source
        assert row.range_source


RANGES = {
    "upper_arm_flexion": ((-60, 180), (-44, 165)), "upper_arm_abduction": ((0, 180), (0, 165)),
    "upper_arm_rotation": ((-90, 70), (-81, 62)), "forearm_flexion": ((0, 150), (4, 143)),
    "forearm_supination": ((-80, 80), (-71, 74)), "hand_flexion": ((-70, 80), (-63, 64)),
    "hand_deviation": ((-30, 20), (-26, 19)), "thigh_flexion": ((-15, 125), (-15, 125)),
}  # fmt: skip
"""Motion -> range of an adult and of an old person [deg]."""


def test_range_of_motion_goes_by_age(body: Body) -> None:
    rows = {row.name: row for row in hinges(body)}
    of_an_arm = "Walker" if body.age_group == "old" else "American Academy"
    for motion, (adult, old) in RANGES.items():
        row = rows[f"right_{motion}"]
        assert row.range_deg == (old if body.age_group == "old" else adult), motion
        assert row.range_source.startswith("Merck" if motion.startswith("thigh") else of_an_arm), motion


def test_a_straight_arm_has_an_elbow_too() -> None:
    """In a T-pose the forearm comes forward; with the crook facing up in the lying arm, it comes up."""
    out = np.array([1.0, 0.0, 0.0])
    np.testing.assert_allclose(np.cross(elbow_axis(out, out), out), FRONT, atol=1e-12)
    bent = np.array([np.cos(0.3), 0.0, np.sin(0.3)])
    np.testing.assert_allclose(np.cross(elbow_axis(out, bent), out), UP, atol=1e-12)


def test_left_and_right_have_the_same_joints(body: Body) -> None:
    rows = {row.name: row for row in hinges(body)}
    for name, right in rows.items():
        if name.startswith("right_"):
            left = rows["left_" + name.removeprefix("right_")]
            assert left.range_deg == right.range_deg, name
            assert left.bind_deg == pytest.approx(right.bind_deg, abs=0.1), name
            assert (left.stiffness_nm_rad, left.damping_nms_rad) == (right.stiffness_nm_rad, right.damping_nms_rad)


def test_axes_of_one_joint_are_independent(body: Body) -> None:
    """No two hinges of a joint on one line: it would be locked in the bind pose."""
    by_segment: dict[str, list[Hinge]] = {}
    for row in hinges(body):
        by_segment.setdefault(row.segment, []).append(row)
    for segment, rows in by_segment.items():
        if len(rows) > 1:
            assert np.linalg.svd(np.array([r.axis for r in rows]))[1].min() > 0.2, segment


@settings(max_examples=25, deadline=None)
@given(st.lists(st.floats(0, 1), min_size=12, max_size=12))
def test_equal_angles_make_a_mirror_image(body: Body, share: list[float]) -> None:
    rows = {row.name: row for row in hinges(body)}
    angles: dict[str, float] = {}
    for name, s in zip((*ARM, *LEG), share, strict=True):
        low, high = rows[f"right_{name}"].range_deg
        angles |= {f"{side}_{name}": low + s * (high - low) for side in SIDES}
    posed, mirror = Posed(body, angles), np.array([-1.0, 1.0, 1.0])
    for segment in ("upper_arm", "forearm", "hand", "thigh", "shank", "foot"):
        left, right = posed.origin[f"left_{segment}"], posed.origin[f"right_{segment}"]
        np.testing.assert_allclose(left * mirror, right, atol=5e-3, err_msg=segment)
    for k in range(2):
        left, right = (posed.turned(f"{s}_hand", hand_axes(body, s)[k]) for s in SIDES)
        np.testing.assert_allclose(left * mirror, right, atol=0.03)


def test_at_zero_the_arm_hangs_straight(limb: Pose, side: str) -> None:
    posed = limb()
    assert degrees_between(posed.along(f"{side}_upper_arm"), -UP) < 1
    # A carrying angle is left where the bind pose is all but straight.
    assert degrees_between(posed.along(f"{side}_forearm"), -UP) < 3


def test_abduction_lifts_the_arm_away_from_the_midline_in_the_frontal_plane(
    limb: Pose, side: str, outward: np.ndarray
) -> None:
    for angle in (30.0, 52.5, 90.0, 150.0):
        humerus = limb(upper_arm_abduction=angle).along(f"{side}_upper_arm")
        expected = np.sin(np.radians(angle)) * outward - np.cos(np.radians(angle)) * UP
        assert degrees_between(humerus, expected) < 1, angle


def test_shoulder_flexion_lifts_the_arm_forward_and_extension_back(limb: Pose, side: str) -> None:
    for abduction in (0.0, 45.0, 90.0):
        flexed = limb(upper_arm_abduction=abduction, upper_arm_flexion=90).along(f"{side}_upper_arm")
        assert degrees_between(flexed, FRONT) < 1, abduction
        extended = limb(upper_arm_abduction=abduction, upper_arm_flexion=-30).along(f"{side}_upper_arm")
        assert extended @ FRONT == pytest.approx(-np.sin(np.radians(30)), abs=0.02), abduction


def test_positive_shoulder_rotation_turns_the_bent_forearm_to_the_belly(
    limb: Pose, side: str, outward: np.ndarray
) -> None:
    ahead, inward, aside = (
        limb(forearm_flexion=90, upper_arm_rotation=r).along(f"{side}_forearm") for r in (0, 60, -60)
    )
    # The elbow's own axis is some degrees off the frontal plane.
    assert degrees_between(ahead, FRONT) < 8
    assert degrees_between(ahead, inward) == pytest.approx(60, abs=0.5)
    assert inward @ outward < -0.75
    assert aside @ outward > 0.75


def test_elbow_flexion_is_the_angle_between_the_bones_and_bends_forward(limb: Pose, side: str) -> None:
    for angle in (0.0, 12.0, 90.0, 140.0):
        posed = limb(forearm_flexion=angle)
        upper, fore = posed.along(f"{side}_upper_arm"), posed.along(f"{side}_forearm")
        # In the plane of flexion to a hair; between the bones the carrying angle counts too.
        assert degrees_between(upper, fore) == pytest.approx(angle, abs=2)
        assert np.degrees(np.arctan2(fore @ FRONT, fore @ -UP)) == pytest.approx(angle, abs=1.5)
        assert fore @ FRONT == pytest.approx(np.sin(np.radians(angle)), abs=0.02)


def test_at_zero_supination_the_palm_faces_the_thigh(limb: Pose, body: Body, side: str, outward: np.ndarray) -> None:
    palm, thumb = (limb().turned(f"{side}_hand", a) for a in hand_axes(body, side))
    assert degrees_between(palm, -outward) < 20
    assert thumb @ FRONT > 0.9


def test_supination_turns_the_palm_forward_and_pronation_back(limb: Pose, body: Body, side: str) -> None:
    palm = hand_axes(body, side)[0]
    supine, prone = (limb(forearm_supination=s).turned(f"{side}_hand", palm) for s in (80, -80))
    assert supine @ FRONT > 0.9
    assert prone @ FRONT < -0.9


def test_supination_keeps_the_forearm_where_it_is(limb: Pose, side: str) -> None:
    before, after = (limb(forearm_flexion=50, forearm_supination=s) for s in (0, 60))
    np.testing.assert_allclose(before.origin[f"{side}_hand"], after.origin[f"{side}_hand"], atol=1e-12)


@given(st.floats(-170, 170))
def test_supination_is_read_off_a_palm(angle: float) -> None:
    for sign in (1.0, -1.0):
        forearm, elbow = np.array([0.0, 0.0, -1.0]), np.array([-1.0, 0.0, 0.0])
        palm = Rotation.from_rotvec(np.radians(angle) * -sign * forearm).apply(sign * elbow)
        assert supination_of(palm, elbow, forearm, sign) == pytest.approx(angle, abs=1e-9)


def test_wrist_flexion_folds_the_hand_to_the_palm(limb: Pose, body: Body, side: str) -> None:
    hand, palm = f"{side}_hand", hand_axes(body, side)[0]
    straight = limb()
    palm_side = straight.turned(hand, palm)
    flexed, extended = (limb(hand_flexion=a).along(hand) for a in (60, -60))
    assert flexed @ palm_side == pytest.approx(np.sin(np.radians(60)), abs=0.01)
    assert extended @ palm_side == pytest.approx(-np.sin(np.radians(60)), abs=0.01)


def test_positive_wrist_deviation_is_to_the_thumb(limb: Pose, body: Body, side: str) -> None:
    hand, radial = f"{side}_hand", hand_axes(body, side)[1]
    thumb_side = limb().turned(hand, radial)
    assert limb(hand_deviation=15).along(hand) @ thumb_side == pytest.approx(np.sin(np.radians(15)), abs=0.01)


def test_palm_and_radial_axes_are_those_of_the_mesh(body: Body, side: str) -> None:
    palm, radial = hand_axes(body, side)
    along = body.direction(f"{side}_hand")
    np.testing.assert_allclose([palm @ radial, palm @ along, radial @ along], 0, atol=1e-9)
    hand = body.vertices_of(f"{side}_hand") - body.joint_centre[f"{side}_hand"]
    thumb = hand[(hand @ radial).argmax()]
    assert 0.06 < thumb @ along < 0.14, "what sticks out on the radial side is a thumb, shorter than the fingers"
    # Thumb and relaxed fingers are in front of the palm, not behind it.
    assert thumb @ palm > 0.02
    assert (hand @ palm).max() > 2 * -(hand @ palm).min()
    letter = side[0].upper()
    assert (body.landmarks[f"finger2-1.{letter}"] - body.landmarks[f"finger5-1.{letter}"]) @ radial > 0.03


def test_at_zero_the_leg_stands_straight(limb: Pose, side: str) -> None:
    posed = limb()
    assert degrees_between(posed.along(f"{side}_thigh"), -UP) < 0.5
    shank = posed.along(f"{side}_shank")
    assert abs(shank @ FRONT) < 0.01
    assert degrees_between(shank, -UP) < 5


def test_hip_motions(limb: Pose, side: str, outward: np.ndarray) -> None:
    thigh = f"{side}_thigh"
    assert degrees_between(limb(thigh_flexion=90).along(thigh), FRONT) < 1
    assert limb(thigh_abduction=30).along(thigh) @ outward == pytest.approx(0.5, abs=0.01)
    toes_before, toes_after = limb().toes(side), limb(thigh_rotation=30).toes(side)
    assert toes_after @ outward < toes_before @ outward - 0.05, "positive is internal, as in the shoulder"


def test_knee_bends_the_heel_back_and_the_ankle_points_the_toes_down(limb: Pose, side: str) -> None:
    shank = limb(shank_flexion=90).along(f"{side}_shank")
    assert shank @ FRONT < -0.98
    assert limb(foot_plantarflexion=30).toes(side)[2] < limb().toes(side)[2] - 0.04


def test_trunk_and_neck_bend_forward(body: Body) -> None:
    for segment, child in (("abdomen", "head"), ("thorax", "head"), ("neck", "head")):
        bent = Posed(body, {f"{segment}_flexion": 20.0})
        assert (bent.origin[child] - body.joint_centre[child]) @ FRONT > 0.01, segment
    for segment in ("abdomen", "thorax"):
        bent = Posed(body, {f"{segment}_lateral": 20.0})
        moved = bent.origin["head"] - body.joint_centre["head"]
        assert moved[0] > 0.05, "positive is to the left"
        assert abs(moved @ FRONT) < 0.01
    turned = Posed(body, {"neck_rotation": 45.0})
    face = turned.turned("head", FRONT)
    assert face[0] == pytest.approx(np.sin(np.radians(45))), "positive is to the left"


def test_bind_angles_give_the_bind_pose(body: Body) -> None:
    posed = Posed(body, {row.name: row.bind_deg for row in hinges(body)})
    for segment, centre in body.joint_centre.items():
        np.testing.assert_allclose(posed.origin[segment], centre, atol=1e-12)


@given(st.tuples(*[st.floats(-1, 1)] * 3), st.floats(-4, 4))
def test_axis_rotation_is_rodrigues(axis: tuple[float, ...], angle: float) -> None:
    vector = np.array(axis)
    if np.linalg.norm(vector) < 1e-3:
        return
    unit = vector / np.linalg.norm(vector)
    np.testing.assert_allclose(axis_rotation(unit, angle), Rotation.from_rotvec(angle * unit).as_matrix(), atol=1e-9)


def test_rotation_from_bind_is_the_kinematics_own(body: Body) -> None:
    pose = lying_pose_deg(body, 50.0)
    posed, rows = Posed(body, pose), hinges(body)
    for segment in ("right_upper_arm", "right_forearm", "left_thigh"):
        parent = posed.rotation[PARENT[segment] or ""].as_matrix()
        np.testing.assert_allclose(
            parent @ rotation_from_bind(rows, segment, pose), posed.rotation[segment].as_matrix(), atol=1e-9
        )


def test_qpos_of_the_model_is_the_anatomical_angle(scene_of: Callable[[str | None], Scene]) -> None:
    """The compiled person, hinge by hinge at odd angles, stands where the table's kinematics puts her."""
    scene = scene_of("forearm")
    model, data = scene.model, mujoco.MjData(scene.model)
    body, pose = scene.body, {}
    for k, row in enumerate(hinges(body)):
        if row.segment in FIXED_SEGMENTS:
            if row.name in (welded := lying_pose_deg(body, 0.0)):
                pose[row.name] = welded[row.name]
            continue
        low, high = row.range_deg
        pose[row.name] = low + (high - low) * ((0.3 + 0.17 * k) % 1.0)
        joint = model.joint(f"human_{row.name}")
        data.qpos[joint.qposadr[0]] = np.radians(pose[row.name])
        np.testing.assert_allclose(joint.range, np.radians(row.range_deg))
    mujoco.mj_kinematics(model, data)
    posed = Posed(body, pose)
    root = data.body("human_pelvis")
    turn = matrix_from_quat(root.xquat)
    for segment in body.segments:
        at = data.body(body_name(segment)).xpos
        expected = root.xpos + turn @ (posed.origin[segment] - body.joint_centre["pelvis"])
        np.testing.assert_allclose(at, expected, atol=1e-9, err_msg=segment)

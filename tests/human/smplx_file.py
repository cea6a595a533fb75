"""A file with the keys of an SMPL-X archive, its geometry a shipped body's in a T-pose with palms down.

The real file is under a licence that forbids shipping it, so that no test can use it.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np

from carecontact.human.body import Body
from carecontact.human.joints import hinges
from carecontact.human.library import JOINTS, LANDMARKS, SEGMENT_JOINTS, TO_MESH, load_body
from carecontact.human.pose import axis_rotation, rotation_from_bind

T_POSE_DEG = {"upper_arm_abduction": 90.0, "forearm_flexion": 0.0}
PARENTS = {
    "left_hip": "pelvis", "right_hip": "pelvis", "spine1": "pelvis", "left_knee": "left_hip",
    "right_knee": "right_hip", "spine2": "spine1", "left_ankle": "left_knee", "right_ankle": "right_knee",
    "spine3": "spine2", "left_foot": "left_ankle", "right_foot": "right_ankle", "neck": "spine3",
    "left_collar": "spine3", "right_collar": "spine3", "head": "neck", "left_shoulder": "left_collar",
    "right_shoulder": "right_collar", "left_elbow": "left_shoulder", "right_elbow": "right_shoulder",
    "left_wrist": "left_elbow", "right_wrist": "right_elbow", "jaw": "head", "left_eye": "head", "right_eye": "head",
}  # fmt: skip


def smplx_arrays(name: str = "woman-old-heavy", *, texture: bool = False) -> dict[str, np.ndarray]:
    """``texture``: with the body's own texture coordinates."""
    return {k: v.copy() for k, v in _arrays(name).items() if texture or k not in ("vt", "ft")}


@cache
def _arrays(name: str) -> dict[str, np.ndarray]:
    body = load_body(name)
    dense = np.zeros((len(body.vertices), len(body.segments)))
    np.put_along_axis(dense, body.weight_segment, body.weight, 1)
    vertices, places = t_pose(body, dense)
    weights = np.zeros((len(vertices), len(JOINTS)))
    for k, segment in enumerate(body.segments):
        weights[:, JOINTS.index(SEGMENT_JOINTS[segment][0])] = dense[:, k]
    eyes = body.is_eye
    for eye, side in (("left_eye", vertices[:, 0] > 0), ("right_eye", vertices[:, 0] < 0)):
        weights[eyes & side] = np.eye(len(JOINTS))[JOINTS.index(eye)]
    # The shortest row that gives the wanted place from all vertices, its entries adding up to one.
    rows = np.vstack([vertices.T, np.ones(len(vertices))])
    wanted = np.array([[*places.get(joint, places["pelvis"]), 1.0] for joint in JOINTS])
    regressor = wanted @ np.linalg.solve(rows @ rows.T, rows)
    parents = [-1] + [JOINTS.index(PARENTS.get(joint) or finger_parent(joint)) for joint in JOINTS[1:]]
    arrays = {"v_template": vertices @ TO_MESH, "f": body.faces.astype(np.uint32), "weights": weights}
    arrays |= {"J_regressor": regressor, "kintree_table": np.array([parents, range(len(JOINTS))], np.int64)}
    arrays["shapedirs"] = np.stack([0.01 * vertices @ TO_MESH, np.zeros_like(vertices)], -1)
    arrays["posedirs"] = np.zeros((3, 3, 1))
    return arrays | {"vt": body.uv, "ft": body.uv_faces.astype(np.uint32)}


def write_smplx(path: Path, **changed: np.ndarray | None) -> Path:
    """``changed``: arrays to replace, None to leave one out."""
    arrays = smplx_arrays() | changed
    np.savez(path, **{k: v for k, v in arrays.items() if v is not None})
    return path


def finger_parent(joint: str) -> str:
    return f"{joint[:-1]}{int(joint[-1]) - 1}" if joint[-1] in "23" else f"{joint.partition('_')[0]}_wrist"


def t_pose(body: Body, dense: np.ndarray) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Vertices and joints of the body with straight arms held out and palms down, mesh frame."""
    vertices = body.vertices.copy()
    places = {SEGMENT_JOINTS[s][0]: body.joint_centre[s].copy() for s in body.segments}
    places |= {theirs: body.landmarks[ours].copy() for ours, theirs in LANDMARKS.items()}
    places["spine3"] = (places["spine2"] + places["neck"]) / 2
    rows = hinges(body)
    for side, sign in (("left", 1.0), ("right", -1.0)):
        arm = [f"{side}_{n}" for n in ("upper_arm", "forearm", "hand")]
        parts = tuple(f"{side}_{part}" for part in ("elbow", "wrist", "middle", "index", "pinky"))
        moving = [place for place in places if place.startswith(parts)]

        def turn(turns: np.ndarray, centre: np.ndarray, share: np.ndarray, points: list[str]) -> None:
            nonlocal vertices
            vertices = vertices + share[:, None] * ((vertices - centre) @ (turns - np.eye(3)).T)
            for point in points:
                places[point] = centre + turns @ (places[point] - centre)

        weight = [dense[:, [body.segments.index(s) for s in arm[k:]]].sum(1) for k in range(3)]
        raised = rotation_from_bind(rows, arm[0], {f"{arm[0]}_abduction": T_POSE_DEG["upper_arm_abduction"]})
        turn(raised, places[f"{side}_shoulder"], weight[0], moving)
        upper, fore = (
            places[f"{side}_{b}"] - places[f"{side}_{a}"] for a, b in (("shoulder", "elbow"), ("elbow", "wrist"))
        )
        bend = np.cross(upper, fore)
        angle = np.arctan2(np.linalg.norm(bend), upper @ fore)
        unbend = axis_rotation(bend / np.linalg.norm(bend), -angle)
        turn(unbend, places[f"{side}_elbow"], weight[1], [p for p in moving if not p.endswith("elbow")])
        # From palm up to palm down, spread along the forearm.
        elbow, wrist = places[f"{side}_elbow"], places[f"{side}_wrist"]
        axis, length = (wrist - elbow) / np.linalg.norm(wrist - elbow), np.linalg.norm(wrist - elbow)
        for k, point in enumerate(vertices):
            share = weight[1][k] * np.clip((point - elbow) @ axis / length, 0, 1)
            if share > 1e-6:
                vertices[k] = elbow + axis_rotation(axis, sign * np.radians(140) * share) @ (point - elbow)
        for point in moving:
            if not point.endswith(("elbow", "wrist")):
                places[point] = elbow + axis_rotation(axis, sign * np.radians(140)) @ (places[point] - elbow)
    return vertices, places

"""The compiled person against the body it is built from: inertia and open places."""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np
import pytest

from carecontact.kernel.readings import Readings
from carecontact.regions import REGIONS, STANDARD_REGIONS
from carecontact.world.human.anthropometry import segment_inertias
from carecontact.world.human.plates import plate_body, plates_of
from carecontact.world.human.pose import lying_pose_deg
from carecontact.world.human.skeleton import body_name
from carecontact.world.scene import Scene

RADIUS, OPEN_M = 0.012, 0.040


@pytest.mark.parametrize("region", sorted(STANDARD_REGIONS))
def test_bone_and_shell_together_have_the_segments_inertia(scene_of: Callable[..., Scene], region: str) -> None:
    """Mass, centre of mass and inertia tensor of de Leva's segment; the bone's counts its shell, and its plates go with
    it."""
    model, body = scene_of(region).model, scene_of(region).body
    segment = REGIONS[region].segment
    parts = [model.body(name).id for name in (body_name(segment), *(plate_body(p.name) for p in plates_of(segment)))]
    row, origin = segment_inertias(body)[segment], body.joint_centre[segment]
    mass = model.body_mass[parts]
    centre = mass @ model.body_ipos[parts] / mass.sum()
    tensor, turn = np.zeros((3, 3)), np.zeros(9)
    for part in parts:
        mujoco.mju_quat2Mat(turn, model.body_iquat[part])
        off = model.body_ipos[part] - centre
        tensor += turn.reshape(3, 3) @ np.diag(model.body_inertia[part]) @ turn.reshape(3, 3).T
        tensor += model.body_mass[part] * (off @ off * np.eye(3) - np.outer(off, off))
    assert mass.sum() == pytest.approx(row.mass_kg, rel=1e-6)
    np.testing.assert_allclose(origin + centre, row.centre_m, atol=1e-5)
    wanted = row.axes @ np.diag(row.moments_kgm2) @ row.axes.T
    np.testing.assert_allclose(tensor, wanted, atol=0.01 * row.moments_kgm2.max())


def test_nothing_of_the_person_is_open_to_the_tool(scene_of: Callable[..., Scene]) -> None:
    """A tool-sized ball let down on a 30 mm grid meets something at most 40 mm under the skin (neck, armpit)."""
    scene = scene_of("forearm")
    model = scene.model
    data = mujoco.MjData(model)
    pose = lying_pose_deg(scene.body, 52.5)
    for hinge in scene.hinges:
        angle = pose.get(hinge.name, hinge.bind_deg)
        data.qpos[model.joint(f"human_{hinge.name}").qposadr[0]] = np.radians(angle)
    mujoco.mj_forward(model, data)
    skin = skin_in_world(model, data)
    touchable = [
        g for g in range(model.ngeom)
        if model.geom_conaffinity[g] & 1 and model.body(model.geom_bodyid[g]).name.startswith("human_")
    ]  # fmt: skip
    felt = [Readings(model, name) for name in scene.regions]
    shells = np.concatenate([data.xpos[f.bone] + f.places @ data.xmat[f.bone].reshape(3, 3).T for f in felt])
    open_places, probed = [], 0
    for x in np.arange(-0.95, 0.80, 0.03):
        for y in np.arange(-0.35, 0.75, 0.03):
            # Off the outline, where a ball slides down the side of the body anyway.
            around = [(x + dx, y + dy) for dx, dy in ((0, 0), (0.02, 0), (-0.02, 0), (0, 0.02), (0, -0.02))]
            if any(np.hypot(skin[:, 0] - a, skin[:, 1] - b).min() > 0.012 for a, b in around):
                continue
            top = skin[np.hypot(skin[:, 0] - x, skin[:, 1] - y) < 0.012, 2].max()
            probed += 1
            over_shell = shells[np.hypot(shells[:, 0] - x, shells[:, 1] - y) < 0.030]
            reach = over_shell[:, 2].max(initial=-1.0)
            for g in touchable:
                # The ball meets what lies under any part of it.
                for dx, dy in ((0, 0), (RADIUS, 0), (-RADIUS, 0), (0, RADIUS), (0, -RADIUS)):
                    reach = max(reach, ray_down(model, data, g, np.array([x + dx, y + dy, 1.5])))
            if top - reach > OPEN_M:
                open_places.append((round(x, 2), round(y, 2), round(float(top - reach), 3)))
    assert probed > 300
    assert open_places == []


def ray_down(model: mujoco.MjModel, data: mujoco.MjData, geom: int, start: np.ndarray) -> float:
    """Height at which a vertical ray meets one geom, -1 if it does not."""
    direction = np.array([0.0, 0.0, -1.0])
    if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_MESH:
        distance = mujoco.mj_rayMesh(model, data, geom, start, direction, None)
    else:
        distance = mujoco.mju_rayGeom(
            data.geom_xpos[geom],
            data.geom_xmat[geom],
            model.geom_size[geom],
            start,
            direction,
            model.geom_type[geom],
            None,
        )
    return start[2] - distance if distance >= 0 else -1.0


def skin_in_world(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    scene = mujoco.MjvScene(model, maxgeom=2000)
    mujoco.mjv_updateScene(
        model, data, mujoco.MjvOption(), mujoco.MjvPerturb(), mujoco.MjvCamera(), int(mujoco.mjtCatBit.mjCAT_ALL), scene
    )
    return np.asarray(scene.skinvert).reshape(-1, 3)[: model.nskinvert].astype(np.float64)

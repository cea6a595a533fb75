"""The process of part (f): recomputes time, encoders, poses and images of every observation from the recorded state,
with a second renderer that has no code of the first."""

from __future__ import annotations

import json
import sys
from functools import cached_property
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt
from mujoco.gl_context import GLContext

from carecontact.audit.hidden_values import without_noise
from carecontact.audit.raw_log import (
    IMAGES,
    SPEC,
    LoggedLook,
    differences,
    intrinsics,
    read_looks,
    read_meta,
    read_spec,
)
from carecontact.audit.watched import DRAWN, robot_addresses
from carecontact.episode.randomization import (
    calibration,
    drawn,
    randomize_appearance,
    sensor_noise,
    set_place,
    with_foam,
)
from carecontact.human.foam import FoamPatch
from carecontact.human.library import load_body
from carecontact.human.pose import root_position
from carecontact.interface.robot import Robot
from carecontact.protocol.protocol import Protocol, TrialSpec
from carecontact.protocol.sections import Camera
from carecontact.sensing.builder import SensorNoise
from carecontact.sensing.calibration import Calibration
from carecontact.sim.rendering import DEPTH_RANGE_M
from carecontact.world.robot import VISUAL_GROUP, add_robot
from carecontact.world.room import FURNITURE_GROUP, SUPPORT, add_furniture, add_light
from carecontact.world.scene import add_cameras, build_scene

F64 = npt.NDArray[np.float64]


class Pictures:
    """Draws pictures of one model without shadows and multisampling, as the cell's cameras do, with no code of the
    renderer that made the policy's. MUJOCO_GL names the backend."""

    def __init__(self, model: mujoco.MjModel, cameras: dict[str, Camera]) -> None:
        self.model, self._cameras = model, cameras
        width, height = (max(getattr(c, side) for c in cameras.values()) for side in ("width", "height"))
        model.vis.quality.offsamples = 0
        self._context: Any = GLContext(width, height)
        self._context.make_current()
        self._mjr = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100.value)
        mujoco.mjr_resizeOffscreen(width, height, self._mjr)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, self._mjr)
        self._mjr.readDepthMap = mujoco.mjtDepthMap.mjDEPTH_ZEROFAR.value
        self._scene = mujoco.MjvScene(model, maxgeom=4 * model.ngeom + 1000)
        self._scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = False
        self._scene.flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = False

    def rgb(self, data: mujoco.MjData, camera: str) -> npt.NDArray[np.uint8]:
        """Return the colour image (H, W, 3) of a camera."""
        image = np.empty((*self._size(camera), 3), np.uint8)
        self._draw(data, camera, None, image, None)
        return np.ascontiguousarray(image[::-1])

    def upload(self, texture: str) -> None:
        self._context.make_current()
        mujoco.mjr_uploadTexture(self.model, self._mjr, self.model.texture(texture).id)

    def depth(self, data: mujoco.MjData, camera: str, *, group: int | None = None) -> npt.NDArray[np.float32]:
        """Return the depth (H, W) [m] along the optical axis, NaN beyond DEPTH_RANGE_M."""
        buffer = np.empty(self._size(camera), np.float32)
        self._draw(data, camera, group, None, buffer)
        near, far = (self.model.stat.extent * clip for clip in (self.model.vis.map.znear, self.model.vis.map.zfar))
        # Reversed depth: 1 at the near plane, 0 at the far plane.
        metres = near * far / (buffer[::-1].astype(np.float64) * (far - near) + near)
        metres[metres > min(DEPTH_RANGE_M, 0.999 * far)] = np.nan
        return metres.astype(np.float32)

    def _size(self, camera: str) -> tuple[int, int]:
        return self._cameras[camera].height, self._cameras[camera].width

    def _draw(self, data: mujoco.MjData, camera: str, group: int | None, *into: npt.NDArray[Any] | None) -> None:
        """Draw into a colour image and a depth image, of which one is None."""
        self._context.make_current()
        option, view = mujoco.MjvOption(), mujoco.MjvCamera()
        if group is not None:
            for groups in ("geomgroup", "sitegroup", "skingroup", "flexgroup", "tendongroup"):
                getattr(option, groups)[:] = 0
            option.geomgroup[group] = 1
        view.type, view.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, self.model.camera(camera).id
        mujoco.mjv_updateScene(
            self.model, data, option, mujoco.MjvPerturb(), view, mujoco.mjtCatBit.mjCAT_ALL.value, self._scene
        )
        height, width = self._size(camera)
        rect = mujoco.MjrRect(0, 0, width, height)
        mujoco.mjr_render(rect, self._scene, self._mjr)
        mujoco.mjr_readPixels(*into, rect, self._mjr)


def cell_model(protocol: Protocol, *, like: mujoco.MjModel | None = None) -> mujoco.MjModel:
    """Return the model of the empty cell: robot, furniture, light and cameras, but no person.

    ``like``: the model with the person, from which pillow and arm board take their place and pictures their clip
    planes.
    """
    spec, body = mujoco.MjSpec(), load_body(protocol.person.body)
    spec.compiler.degree = False
    add_robot(spec, protocol)
    x, y, _ = root_position(body, protocol.scene.mattress_top_m)
    # The pillow lies under the head, as ``world.scene`` has it.
    head_x = x + body.joint_centre["head"][2] - body.joint_centre["pelvis"][2] + 0.04
    add_furniture(spec, protocol.scene, head_x=float(head_x), head_y=float(y))
    add_light(spec)
    add_cameras(spec, protocol)
    model = spec.compile()
    if like is not None:
        model.stat.extent = like.stat.extent
        model.body(SUPPORT).pos[:], model.body(SUPPORT).quat[:] = like.body(SUPPORT).pos, like.body(SUPPORT).quat
    return model


CV_FROM_GL = np.diag([1.0, -1.0, -1.0])

REDRAW_BOOTSTRAP = """
import sys
sys.path.insert(0, sys.argv[1])
from carecontact.audit.redraw import main
main(sys.argv[2])
"""


def main(folder: str) -> None:
    """Print JSON: ``looks`` of every trial, as ``rederive.main`` does, and ``images``, the number of images drawn."""
    worlds: dict[str, _World] = {}
    looks: list[dict[str, Any]] = []
    for trial in sorted(path for path in Path(folder).iterdir() if (path / SPEC).is_file()):
        spec = read_spec(trial)
        key = _key(spec)
        world = worlds[key] = worlds.get(key) or _World(spec)
        policy = read_meta(trial).policy
        noise = sensor_noise(spec.protocol, spec.seed, salt=spec.salt, noise_salt=spec.noise_salt)
        known, dt_s = calibration(spec.protocol, spec.seed, salt=spec.salt), spec.protocol.physics.dt_s
        for look in read_looks(trial):
            row = {"trial": trial.name, "policy": policy, "time_s": look.state.steps * dt_s}
            looks.append({**row, "differences": world.differences(look, noise, known)})
    sys.stdout.write(json.dumps({"looks": looks, "images": sum(w.images for w in worlds.values())}) + "\n")


def _key(spec: TrialSpec) -> str:
    """Return a text that is equal for trials of the same world, whatever their length and sensor noise."""
    protocol = without_noise(spec.protocol).model_dump(mode="json", exclude={"phases"})
    return json.dumps([protocol, spec.task_id, spec.seed, spec.salt], sort_keys=True)


class _World:
    """A world that this process builds from protocol and seed, so that it shares nothing with the audited process."""

    def __init__(self, spec: TrialSpec) -> None:
        self._spec, self.images = spec, 0
        self._foam: FoamPatch | None = None
        self._drawn = drawn(spec)
        self._cameras = {str(name): camera for name, camera in self._drawn.protocol.cameras.items()}
        self._cell, self._robot = cell_model(self._drawn.protocol), self._drawn.protocol.scene.robot

    def differences(self, look: LoggedLook, noise: SensorNoise, known: Calibration) -> list[tuple[str, str]]:
        """Return pairs of a place and a difference, to the last bit, for all readings behind one message."""
        state, raw = look.state, look.raw
        now_s = state.steps * self._spec.protocol.physics.dt_s
        angles = noise.joint_position(state.joint_position, sim_time_s=now_s)
        data = _at(self._cell, self._robot, angles, known)
        tool = data.site(self._robot.tcp_site)
        held = _in_base(data, self._robot, tool.xpos, tool.xmat)
        speeds = noise.joint_velocity(state.joint_velocity, sim_time_s=now_s)
        rows: list[tuple[str, Any, Any]] = [
            ("sim_time_s", now_s, look.sim_time_s),
            ("joint_position", angles, raw.joint_position),
            ("joint_velocity", speeds, raw.joint_velocity),
            ("pose_tcp_in_base", held, raw.pose_tcp_in_base),
        ]
        if (moving := raw.velocity_tcp_in_base) is not None:
            rows.append(("velocity_tcp_in_base", _moving(self._cell, data, self._robot, speeds), moving))
        for name, view in raw.views.items():
            camera, optics = data.cam(name), intrinsics(self._cameras[name].model_dump())
            pose = _in_base(data, self._robot, camera.xpos, camera.xmat.reshape(3, 3) @ CV_FROM_GL)
            rows.append((f"cameras.{name}.intrinsics", optics, view.intrinsics))
            rows.append((f"cameras.{name}.pose_camera_in_base", pose, view.pose_camera_in_base))
            for image in IMAGES:
                shown = getattr(view, image)
                if shown is None:
                    continue
                again = self._image(image, name, look, angles, known)
                if image == "depth":
                    again = noise.depth(again, optics, camera=name, sim_time_s=now_s)
                rows.append((f"cameras.{name}.{image}", again, shown))
        return [
            (where, f"is not what the recorded state gives: {what}")
            for place, expected, got in rows
            for where, what in differences(expected, got, f"observation.{place}")
        ]

    def _image(self, image: str, camera: str, look: LoggedLook, angles: F64, known: Calibration) -> npt.NDArray[Any]:
        self.images += 1
        groups = {"robot_depth": VISUAL_GROUP, "cell_depth": FURNITURE_GROUP}
        if image in groups:
            empty = _at(self._empty.model, self._robot, angles, known)
            return self._empty.depth(empty, camera, group=groups[image])
        model = self._whole.model
        data = mujoco.MjData(model)
        mujoco.mj_setState(model, data, look.state.vector, DRAWN)
        mujoco.mj_kinematics(model, data)
        mujoco.mj_camlight(model, data)
        if image != "rgb":
            return self._whole.depth(data, camera)
        if self._foam is not None:
            self._foam.paint(model, look.foam_left)
            self._whole.upload("human_skin")
        return self._whole.rgb(data, camera)

    @cached_property
    def _whole(self) -> Pictures:
        spec = self._spec
        scene = build_scene(self._drawn.protocol, target=spec.protocol.task(spec.task_id).region)
        randomize_appearance(scene, spec.seed, salt=spec.salt)
        self._foam = with_foam(scene, spec.task_id, spec.seed, salt=spec.salt).foam
        set_place(scene, self._drawn.place)
        return Pictures(scene.model, self._cameras)

    @cached_property
    def _empty(self) -> Pictures:
        return Pictures(cell_model(self._drawn.protocol, like=self._whole.model), self._cameras)


def _at(model: mujoco.MjModel, robot: Robot, angles: F64, known: Calibration) -> mujoco.MjData:
    """Return a state with the robot at these joint angles and every fixed camera where the cell believes it to be."""
    data = mujoco.MjData(model)
    data.qpos[robot_addresses(model, robot)[0]] = angles
    mujoco.mj_kinematics(model, data)
    mujoco.mj_camlight(model, data)
    for name, error in known.items():
        camera = data.cam(name)
        rotation = camera.xmat.reshape(3, 3) @ CV_FROM_GL
        camera.xpos[:] = camera.xpos + rotation @ error[:3, 3]
        camera.xmat[:] = (rotation @ error[:3, :3] @ CV_FROM_GL).ravel()
    return data


def _moving(model: mujoco.MjModel, data: mujoco.MjData, robot: Robot, speeds: F64) -> F64:
    """Return velocity and angular velocity (6,) of the tool in the robot's base, for speeds (joints,) of its joints."""
    linear, angular = np.zeros((3, model.nv)), np.zeros((3, model.nv))
    mujoco.mj_comPos(model, data)
    mujoco.mj_jacSite(model, data, linear, angular, model.site(robot.tcp_site).id)
    moved = np.vstack([linear, angular])[:, robot_addresses(model, robot)[1]] @ speeds
    return (moved.reshape(2, 3) @ data.body(robot.base_body).xmat.reshape(3, 3)).ravel()


def _in_base(data: mujoco.MjData, robot: Robot, position: F64, rotation: F64) -> F64:
    """Turn a position (3,) [m] and a rotation (3, 3) or (9,) in the world into a pose (4, 4) in the robot's base."""
    base, pose = data.body(robot.base_body), np.eye(4)
    to_base = base.xmat.reshape(3, 3).T
    pose[:3, :3] = to_base @ rotation.reshape(3, 3)
    pose[:3, 3] = to_base @ (position - base.xpos)
    return pose

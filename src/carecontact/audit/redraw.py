"""The process of part (f): recomputes time, encoders, poses and images of every observation from the recorded state."""

from __future__ import annotations

import json
import sys
from functools import cached_property
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt

from carecontact.audit.canary import without_noise
from carecontact.audit.cell_geometry import intrinsics
from carecontact.audit.differences import differences
from carecontact.audit.pictures import Pictures, cell_model
from carecontact.audit.raw_log import IMAGES, SPEC, LoggedLook, WorldState, read_looks, read_meta, read_spec
from carecontact.audit.state import DRAWN, robot_addresses
from carecontact.contract.embodiment import Robot
from carecontact.contract.trial import TrialSpec
from carecontact.episode.drawn import drawn
from carecontact.episode.randomization import calibration, dress, lay, sensor_noise
from carecontact.observation.calibration import Calibration
from carecontact.observation.sensor_noise import SensorNoise
from carecontact.world.furniture import FURNITURE_GROUP
from carecontact.world.robot import VISUAL_GROUP
from carecontact.world.scene import build_scene

F64 = npt.NDArray[np.float64]
CV_FROM_GL = np.diag([1.0, -1.0, -1.0])

BOOTSTRAP = """
import sys
sys.path.insert(0, sys.argv[1])
from carecontact.audit.redraw import main
main(sys.argv[2])
"""
"""Program for ``python -c``. Its arguments are the folder of the package and that of the trial logs (``raw_log``)."""


def main(folder: str) -> None:
    """Print one JSON object: ``looks`` of every trial, as ``rederive.main`` does, and ``images``, the number of images
    drawn.
    """
    worlds: dict[str, _World] = {}
    looks: list[dict[str, Any]] = []
    for trial in sorted(path for path in Path(folder).iterdir() if (path / SPEC).is_file()):
        spec = read_spec(trial)
        key = _key(spec)
        world = worlds[key] = worlds.get(key) or _World(spec)
        policy = read_meta(trial).policy
        noise = sensor_noise(spec.protocol, spec.seed, salt=spec.salt, noise_salt=spec.noise_salt)
        known, dt_s = calibration(spec.protocol, spec.seed, salt=spec.salt), spec.protocol.physics.dt_s
        looks += [
            {
                "trial": trial.name,
                "policy": policy,
                "time_s": look.state.steps * dt_s,
                "differences": world.differences(look, noise, known),
            }
            for look in read_looks(trial)
        ]
    sys.stdout.write(json.dumps({"looks": looks, "images": sum(w.images for w in worlds.values())}) + "\n")


def _key(spec: TrialSpec) -> str:
    """Return a text that is equal for trials of the same world, whatever their length and sensor noise."""
    protocol = without_noise(spec.protocol).model_dump(mode="json", exclude={"phases"})
    return json.dumps([protocol, spec.task_id, spec.seed, spec.salt], sort_keys=True)


class _World:
    """A world that this process builds from protocol and seed, so that it shares nothing with the audited process."""

    def __init__(self, spec: TrialSpec) -> None:
        self._spec, self.images = spec, 0
        self._drawn = drawn(spec)
        self._cameras = {str(name): camera for name, camera in self._drawn.protocol.cameras.items()}
        self._cell, self._robot = cell_model(self._drawn.protocol), self._drawn.protocol.scene.robot

    def differences(self, look: LoggedLook, noise: SensorNoise, known: Calibration) -> list[tuple[str, str]]:
        """Return pairs of a place and a difference, to the last bit, for all readings behind one message.

        ``known``: the error with which the cell knows its cameras.
        """
        state, raw = look.state, look.raw
        now_s = state.steps * self._spec.protocol.physics.dt_s
        angles = noise.joint_position(state.joint_position, sim_time_s=now_s)
        data = _at(self._cell, self._robot, angles, known)
        tool = data.site(self._robot.tcp_site)
        rows: list[tuple[str, Any, Any]] = [
            ("sim_time_s", now_s, look.sim_time_s),
            ("joint_position", angles, raw.joint_position),
            ("joint_velocity", state.joint_velocity, raw.joint_velocity),
            (
                "pose_tcp_in_base",
                _in_base(data, self._robot, tool.xpos, tool.xmat),
                raw.pose_tcp_in_base,
            ),
        ]
        for name, view in raw.views.items():
            camera, optics = data.cam(name), intrinsics(self._cameras[name].model_dump())
            pose = _in_base(data, self._robot, camera.xpos, camera.xmat.reshape(3, 3) @ CV_FROM_GL)
            rows.append((f"cameras.{name}.intrinsics", optics, view.intrinsics))
            rows.append((f"cameras.{name}.pose_camera_in_base", pose, view.pose_camera_in_base))
            for image in IMAGES:
                shown = getattr(view, image)
                if shown is None:
                    continue
                again = self._image(image, name, state, angles, known)
                if image == "depth":
                    again = noise.depth(again, optics, camera=name, sim_time_s=now_s)
                rows.append((f"cameras.{name}.{image}", again, shown))
        return [
            (where, f"is not what the recorded state gives: {what}")
            for place, expected, got in rows
            for where, what in differences(expected, got, f"observation.{place}")
        ]

    def _image(self, image: str, camera: str, state: WorldState, angles: F64, known: Calibration) -> npt.NDArray[Any]:
        self.images += 1
        if image == "robot_depth":
            return self._empty.depth(_at(self._empty.model, self._robot, angles, known), camera, group=VISUAL_GROUP)
        if image == "cell_depth":
            return self._empty.depth(_at(self._empty.model, self._robot, angles, known), camera, group=FURNITURE_GROUP)
        model = self._whole.model
        data = mujoco.MjData(model)
        mujoco.mj_setState(model, data, state.vector, DRAWN)
        mujoco.mj_kinematics(model, data)
        mujoco.mj_camlight(model, data)
        return self._whole.rgb(data, camera) if image == "rgb" else self._whole.depth(data, camera)

    @cached_property
    def _whole(self) -> Pictures:
        spec = self._spec
        scene = build_scene(self._drawn.protocol, target=spec.protocol.task(spec.task_id).region)
        dress(scene, spec.seed, salt=spec.salt)
        lay(scene, self._drawn.place)
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


def _in_base(data: mujoco.MjData, robot: Robot, position: F64, rotation: F64) -> F64:
    """Turn a position (3,) [m] and a rotation matrix (3, 3) or (9,) in the world into a pose (4, 4) in the robot's
    base.
    """
    base, pose = data.body(robot.base_body), np.eye(4)
    to_base = base.xmat.reshape(3, 3).T
    pose[:3, :3] = to_base @ rotation.reshape(3, 3)
    pose[:3, 3] = to_base @ (position - base.xpos)
    return pose

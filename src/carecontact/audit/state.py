"""Reads the simulator's state through MuJoCo's own interface, without any code that makes observations."""

from __future__ import annotations

import mujoco
import numpy as np

from carecontact.audit.raw_log import WorldState
from carecontact.contract.embodiment import Robot
from carecontact.sim.simulation import Simulation

DRAWN = int(
    mujoco.mjtState.mjSTATE_TIME | mujoco.mjtState.mjSTATE_QPOS | mujoco.mjtState.mjSTATE_QVEL
    | mujoco.mjtState.mjSTATE_MOCAP_POS | mujoco.mjtState.mjSTATE_MOCAP_QUAT
)  # fmt: skip
"""The parts of MuJoCo's integration state that pictures depend on. The sensor history, a hundred times as long, is not
among them."""


class StateReader:
    """Reads one simulation. It must be made at t = 0, from which it counts steps."""

    def __init__(self, simulation: Simulation) -> None:
        self._model, self._data = simulation.model, simulation.data
        self._begin_s = float(self._data.time)
        self._qpos, self._dof = robot_addresses(self._model, simulation.robot)

    def read(self) -> WorldState:
        vector = np.zeros(mujoco.mj_stateSize(self._model, DRAWN))
        mujoco.mj_getState(self._model, self._data, vector, DRAWN)
        return WorldState(
            # MuJoCo's clock accumulates rounding errors, which stay far below one step in any trial.
            steps=round((float(self._data.time) - self._begin_s) / self._model.opt.timestep),
            joint_position=self._data.qpos[self._qpos].copy(), joint_velocity=self._data.qvel[self._dof].copy(),
            vector=vector,
        )  # fmt: skip


def robot_addresses(model: mujoco.MjModel, robot: Robot) -> tuple[list[int], list[int]]:
    """Return the addresses of the robot's joints in qpos and in qvel."""
    joints = [model.joint(name) for name in robot.joints]
    return [int(j.qposadr[0]) for j in joints], [int(j.dofadr[0]) for j in joints]

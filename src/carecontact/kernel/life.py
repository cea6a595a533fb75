"""What a person does by itself, in a compiled model: an instance of the plugin ``carecontact.life``, the numbers that
it reads, and its state. The layouts are those of ``c/life.h``.

The plugin commands actuators: ``breathes_<part>``, a position servo of a slide, and for every muscle's joint
``holds_<joint>``, whose command is an activation from 0 to 1, and ``turns_<joint>``, a torque.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
import numpy.typing as npt

from carecontact.errors import SceneError
from carecontact.kernel import library

Array = npt.NDArray[np.float64]

NAME = "life"
"""Of the plugin's instance, and before its numerics."""
PARTS = ("abdomen", "chest")
"""Of the trunk, which breathing moves."""
JOINTS = ("right_upper_arm_abduction", "right_upper_arm_flexion", "right_upper_arm_rotation", "right_forearm_flexion")
"""That muscles move."""
MOST_MOVES = 64
"""Changes of posture in a trial."""
AWAKE, BEGAN, POSTURE, BASE, REST, WANT, PULLED, PULL_TIME, WORK, STATE_SIZE = 0, 1, 2, 6, 10, 14, 25, 27, 30, 32


@dataclass(frozen=True, kw_only=True)
class Move:
    """A change of posture."""

    time_s: float
    """When it begins, since the person woke."""
    duration_s: float
    lift_rad: float
    """By which the shoulder flexes on the way, so that the arm lies lighter on its board."""
    shift_rad: Array
    """(4,) of JOINTS, from the posture before it"""


@dataclass(frozen=True, kw_only=True)
class Pull:
    """When and how the arm is withdrawn."""

    force_n: float
    for_s: float
    delay_s: float
    duration_s: float
    shift_rad: Array
    """(4,) of JOINTS"""


@dataclass(frozen=True, kw_only=True)
class Doings:
    """What one person does; by default nothing."""

    breath_hz: float = 0.0
    inspiration_share: float = 0.5
    phase: float = 0.0
    """Share of a breath that is over when the person wakes; 0 is the end of a breath out."""
    breath_m: tuple[float, float] = (0.0, 0.0)
    """How far each of PARTS moves."""
    tone: float = 0.0
    """Activation of the muscles at rest."""
    help: float = 0.0
    """Share of the passive joints' stiffness and damping that the person takes away."""
    moves: tuple[Move, ...] = ()
    """In the order of their times, at most MOST_MOVES."""
    pull: Pull | None = None

    def numbers(self) -> dict[str, Array]:
        """Name of a numeric, without NAME -> its values."""
        moves = np.zeros((MOST_MOVES, 3 + len(JOINTS)))
        for row, move in zip(moves, self.moves, strict=False):
            row[:] = move.time_s, move.duration_s, move.lift_rad, *move.shift_rad
        pull = np.zeros(4 + len(JOINTS))
        if self.pull is not None:
            p = self.pull
            pull[:] = p.force_n, p.for_s, p.delay_s, p.duration_s, *p.shift_rad
        return {
            "breath": np.array([self.breath_hz, self.inspiration_share, self.phase, *self.breath_m]),
            "muscle": np.array([self.tone, self.help]), "moves": moves.ravel(), "withdrawal": pull,
        }  # fmt: skip


def add_life(spec: mujoco.MjSpec, carrier: mujoco.MjsBody) -> None:
    """Let the actuators of an uncompiled model be commanded by the plugin. The person does nothing until ``Life.wake``.

    Args:
        carrier: a body without a plugin, to which MuJoCo attaches this one; nothing acts on it.

    Raises DependencyError where the compiled tissue is missing.
    """
    library.load()
    spec.activate_plugin(library.LIFE_PLUGIN)
    for name, values in Doings().numbers().items():
        spec.add_numeric(name=f"{NAME}/{name}", data=values.tolist(), size=values.size)
    made = spec.add_plugin(name=NAME, plugin_name=library.LIFE_PLUGIN, active=True)
    made.config = {}
    carrier.plugin.active, carrier.plugin.name = True, NAME
    carrier.plugin.plugin_name, carrier.plugin.id = library.LIFE_PLUGIN, made


class Life:
    """Of one compiled model."""

    def __init__(self, model: mujoco.MjModel) -> None:
        instance = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_PLUGIN, NAME)
        if instance < 0:
            raise SceneError("the person of this model does nothing by itself")
        first, size = int(model.plugin_stateadr[instance]), int(model.plugin_statenum[instance])
        if size != STATE_SIZE:
            raise SceneError(f"the state of {NAME} has {size} numbers, expected {STATE_SIZE}")
        self._model, self._state = model, slice(first, first + size)
        names = {model.actuator(k).name for k in range(model.nu)}
        self._parts = [model.actuator(f"breathes_{p}").id if f"breathes_{p}" in names else -1 for p in PARTS]
        self._muscles = {
            k: [model.actuator(f"{kind}_{joint}").id for kind in ("holds", "turns")]
            for k, joint in enumerate(JOINTS)
            if f"holds_{joint}" in names
        }
        self._joints = {k: int(model.joint(f"human_{JOINTS[k]}").qposadr[0]) for k in self._muscles}

    @staticmethod
    def exists(model: mujoco.MjModel) -> bool:
        return mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_PLUGIN, NAME) >= 0

    def wake(self, data: mujoco.MjData, doings: Doings) -> None:
        """Let the person begin now, from the posture that it has, in the middle of a breath."""
        for name, values in doings.numbers().items():
            self._model.numeric(f"{NAME}/{name}").data[:] = values
        state = data.plugin_state[self._state]
        state[:] = 0
        state[[AWAKE, BEGAN]] = 1.0, data.time
        for k, address in self._joints.items():
            state[[first + k for first in (POSTURE, BASE, REST, WANT)]] = data.qpos[address]
        height, rate = breath(doings, 0.0)
        for actuator, size in zip(self._parts, doings.breath_m, strict=True):
            if actuator >= 0:
                joint = self._model.joint(int(self._model.actuator_trnid[actuator, 0]))
                data.qpos[joint.qposadr[0]], data.qvel[joint.dofadr[0]] = size * height, size * rate
        mujoco.mj_forward(self._model, data)

    def check_known(self, data: mujoco.MjData) -> None:
        """Raises SceneError where the state is that of a person who is awake, and this model does not know what the
        person does: ``Doings`` are in the model and not in the state.
        """
        asleep = all(
            np.array_equal(self._model.numeric(f"{NAME}/{name}").data, values)
            for name, values in Doings().numbers().items()
        )
        if asleep and data.plugin_state[self._state][AWAKE]:
            raise SceneError(
                "the state is of a person who is awake, and nobody woke the person of this world; call "
                "life.wake(data, doings) with the same doings before the state is restored"
            )

    def breath_m(self, data: mujoco.MjData) -> Array:
        """(2,) how far out each of PARTS is now [m]; 0 where the person does not breathe."""
        length = data.actuator_length
        return np.array([length[a] if a >= 0 else 0.0 for a in self._parts])

    def torque_nm(self, data: mujoco.MjData) -> Array:
        """(4,) of the muscles at JOINTS in the last step [N m]; 0 where the arm has none."""
        out = np.zeros(len(JOINTS))
        for k, pair in self._muscles.items():
            out[k] = data.actuator_force[pair].sum()
        return out

    def moves(self) -> Array:
        """(n, 2) changes of posture that were drawn: when each begins, since the person woke [s], and the turn of the
        shoulder's abduction [rad]."""
        rows = self._model.numeric(f"{NAME}/moves").data.reshape(MOST_MOVES, -1)
        return rows[rows[:, 1] > 0][:, [0, 3]]

    def work_j(self, data: mujoco.MjData) -> Array:
        """(2,) that breathing and the arm's muscles have done since the person woke [J]."""
        return data.plugin_state[self._state][WORK : WORK + 2].copy()

    def pulls_s(self, data: mujoco.MjData) -> Array:
        """(3,) when each withdrawal began or will begin, since the person woke [s]; -1 for what did not happen."""
        state = data.plugin_state[self._state]
        times = state[PULL_TIME:WORK].copy()
        times[int(state[PULLED]) :] = -1.0
        return times


def breath(doings: Doings, time_s: float) -> tuple[float, float]:
    """How far the person has breathed in, from 0 to 1, and its rate [1/s]: half a cosine in, and another out."""
    cycle = (doings.breath_hz * time_s + doings.phase) % 1.0
    inward = cycle < doings.inspiration_share
    share = doings.inspiration_share if inward else 1.0 - doings.inspiration_share
    at = np.pi * (cycle / share if inward else 1.0 + (cycle - doings.inspiration_share) / share)
    return float(1 - np.cos(at)) / 2, float(np.sin(at)) / 2 * np.pi * doings.breath_hz / share

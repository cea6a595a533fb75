"""A person who breathes and moves the arm, in a compiled model.

An instance of the plugin ``carecontact.life`` moves the person. This module writes the numbers that it reads, and reads
its state; their layouts are those of ``c/life.h``. The plugin commands actuators: ``breathes_<part>`` is a position
servo of a slide joint. Each joint with muscles has two: the command of ``holds_<joint>`` is an activation from 0 to 1,
and that of ``turns_<joint>`` is a torque [N m].
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
import numpy.typing as npt
from pydantic import ValidationError

from carecontact.errors import SceneError
from carecontact.protocol.person import Breathing, Repositioning, Withdrawal
from carecontact.tissue import plugin

Array = npt.NDArray[np.float64]

NAME = "life"
"""Name of the plugin's instance, and prefix of the names of its custom numerics."""
PARTS = ("abdomen", "chest")
"""Parts of the trunk that breathing moves."""
JOINTS = ("right_upper_arm_abduction", "right_upper_arm_flexion", "right_upper_arm_rotation", "right_forearm_flexion")
"""Joints that the muscles move."""
MOST_MOVES = 64
"""Largest number of changes of posture in a trial."""
LARGEST_TURN_RAD = 1.0
"""Largest change of a joint's angle in one movement. The protocol's largest movement of the wrist, 0.15 m, turns a
shoulder by a third of this."""
AWAKE, BEGAN, POSTURE, BASE, REST, WANT, PULLED, PULL_TIME, WORK, STATE_SIZE = 0, 1, 2, 6, 10, 14, 25, 27, 30, 32


@dataclass(frozen=True, kw_only=True)
class Move:
    """One change of the arm's posture."""

    time_s: float
    """Time from when the person wakes until the change begins."""
    duration_s: float
    lift_rad: float
    """Angle by which the shoulder flexes meanwhile, so that the arm rests more lightly on its board."""
    shift_rad: Array
    """(4,) change of the angle of each of JOINTS, relative to the posture before"""


@dataclass(frozen=True, kw_only=True)
class Pull:
    """When and how the person withdraws the arm from a force."""

    force_n: float
    """Force above which the person withdraws the arm."""
    for_s: float
    """Time for which the force must stay above it."""
    delay_s: float
    """Reaction time: from then until the withdrawal begins."""
    duration_s: float
    """Time that the withdrawal takes."""
    shift_rad: Array
    """(4,) change of the angle of each of JOINTS"""


@dataclass(frozen=True, kw_only=True)
class MotionScript:
    """What one person does. By default, the person does nothing."""

    breath_hz: float = 0.0
    inspiration_share: float = 0.5
    phase: float = 0.0
    """Part of a breath that is over when the person wakes; 0 is the end of breathing out."""
    breath_m: tuple[float, float] = (0.0, 0.0)
    """Distance by which each of PARTS moves during a breath."""
    tone: float = 0.0
    """Activation of the muscles at rest, from 0 to 1."""
    help: float = 0.0
    """Part of the passive joints' stiffness and damping that the person removes by helping, from 0 to 1."""
    moves: tuple[Move, ...] = ()
    """The changes of posture in the order of their times, at most MOST_MOVES."""
    pull: Pull | None = None

    def check(self) -> None:
        """Raises SceneError for a value that is not finite, or beyond what a protocol's fields allow. A person may hold
        its breath, which no protocol asks for: then ``breath_hz`` is 0."""
        if len(self.moves) > MOST_MOVES:
            raise SceneError(f"the person cannot wake with {len(self.moves)} moves; expected at most {MOST_MOVES}")
        for name, values in self.numbers().items():
            if not np.isfinite(values).all():
                raise SceneError(f"the person cannot wake: {name}: every number must be finite, got {values}")
        turns = [action.shift_rad for action in (*self.moves, self.pull) if action is not None]
        for name, low, values, high in (
            ("phase", 0.0, self.phase, 1.0),
            ("tone", 0.0, self.tone, 1.0),
            ("help", 0.0, self.help, 1.0),
            ("moves: time_s", 0.0, [move.time_s for move in self.moves], np.inf),
            ("moves: lift_rad", -LARGEST_TURN_RAD, [move.lift_rad for move in self.moves], LARGEST_TURN_RAD),
            ("shift_rad", -LARGEST_TURN_RAD, turns, LARGEST_TURN_RAD),
        ):
            for value in np.ravel(values):
                if not low <= value <= high:
                    raise SceneError(f"the person cannot wake: {name}: expected {low:g} to {high:g}, got {value:g}")
        hz = self.breath_hz or Breathing().frequency_hz[0]
        belly, chest = ((size, size) for size in self.breath_m)
        share = self.inspiration_share
        try:
            Breathing(frequency_hz=(hz, hz), abdomen_m=belly, chest_m=chest, inspiration_share=share)
            for move in self.moves:
                Repositioning(duration_s=(move.duration_s, move.duration_s))
            if (p := self.pull) is not None:
                Withdrawal(force_n=(p.force_n, p.force_n), for_s=p.for_s, delay_s=p.delay_s, duration_s=p.duration_s)
        except ValidationError as error:
            first = error.errors()[0]
            field = ".".join(map(str, first["loc"]))
            raise SceneError(f"the person cannot wake: {field}: {first['msg']}, got {first['input']}") from None

    def numbers(self) -> dict[str, Array]:
        """Return the custom numerics that the plugin reads: name without the prefix NAME -> values."""
        moves = np.zeros((MOST_MOVES, 3 + len(JOINTS)))
        for row, move in zip(moves, self.moves, strict=False):
            row[:] = move.time_s, move.duration_s, move.lift_rad, *move.shift_rad
        pull = np.zeros(4 + len(JOINTS))
        if self.pull is not None:
            p = self.pull
            pull[:] = p.force_n, p.for_s, p.delay_s, p.duration_s, *p.shift_rad
        breath = np.array([self.breath_hz, self.inspiration_share, self.phase, *self.breath_m])
        muscle = np.array([self.tone, self.help])
        return {"breath": breath, "muscle": muscle, "moves": moves.ravel(), "withdrawal": pull}


def add_life(spec: mujoco.MjSpec, carrier: mujoco.MjsBody) -> None:
    """Let the actuators of an uncompiled model be commanded by the plugin. The person does nothing until ``Life.wake``.

    Args:
        carrier: a body without a plugin, to which MuJoCo attaches this one; nothing acts on it.

    Raises DependencyError where the compiled tissue is missing.
    """
    plugin.load_plugins()
    spec.activate_plugin(plugin.LIFE_PLUGIN)
    for name, values in MotionScript().numbers().items():
        spec.add_numeric(name=f"{NAME}/{name}", data=values.tolist(), size=values.size)
    made = spec.add_plugin(name=NAME, plugin_name=plugin.LIFE_PLUGIN, active=True)
    made.config = {}
    carrier.plugin.active, carrier.plugin.name = True, NAME
    carrier.plugin.plugin_name, carrier.plugin.id = plugin.LIFE_PLUGIN, made


class Life:
    """The plugin's instance in one compiled model."""

    def __init__(self, model: mujoco.MjModel) -> None:
        instance = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_PLUGIN, NAME)
        if instance < 0:
            raise SceneError("the person of this model does nothing by itself")
        first, size = int(model.plugin_stateadr[instance]), int(model.plugin_statenum[instance])
        if size != STATE_SIZE:
            raise SceneError(f"the state of {NAME} has {size} numbers, expected {STATE_SIZE}")
        self._model, self._state = model, slice(first, first + size)
        actuators = {model.actuator(k).name: k for k in range(model.nu)}
        self._parts = [actuators.get(f"breathes_{part}", -1) for part in PARTS]
        self._muscles = {
            k: [actuators[f"{kind}_{joint}"] for kind in ("holds", "turns")]
            for k, joint in enumerate(JOINTS)
            if f"holds_{joint}" in actuators
        }
        self._joints = {k: int(model.joint(f"human_{JOINTS[k]}").qposadr[0]) for k in self._muscles}

    @staticmethod
    def exists(model: mujoco.MjModel) -> bool:
        return mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_PLUGIN, NAME) >= 0

    def wake(self, data: mujoco.MjData, script: MotionScript) -> None:
        """Let the person begin to breathe and move now, from the present posture and at the given phase of a breath.

        Changes ``data`` and the numerics of the model. Raises SceneError as ``MotionScript.check``.
        """
        script.check()
        for name, values in script.numbers().items():
            self._model.numeric(f"{NAME}/{name}").data[:] = values
        state = data.plugin_state[self._state]
        state[:] = 0
        state[[AWAKE, BEGAN]] = 1.0, data.time
        for k, address in self._joints.items():
            state[[first + k for first in (POSTURE, BASE, REST, WANT)]] = data.qpos[address]
        height, rate = breath(script, 0.0)
        for actuator, size in zip(self._parts, script.breath_m, strict=True):
            if actuator >= 0:
                joint = self._model.joint(int(self._model.actuator_trnid[actuator, 0]))
                data.qpos[joint.qposadr[0]], data.qvel[joint.dofadr[0]] = size * height, size * rate
        mujoco.mj_forward(self._model, data)

    def check_known(self, data: mujoco.MjData) -> None:
        """Raise SceneError if the person in a state is awake and this model's person never woke: the script is in the
        model and not in the state. A state does not show whether the scripts are the same.
        """
        still = MotionScript().numbers()
        asleep = all(np.array_equal(self._model.numeric(f"{NAME}/{name}").data, still[name]) for name in still)
        if asleep and data.plugin_state[self._state][AWAKE]:
            raise SceneError(
                "the state is of a person who is awake, but the person of this world never woke; call "
                "life.wake(data, script) with the same script before you restore the state"
            )

    def breath_m(self, data: mujoco.MjData) -> Array:
        """Return (2,) how far each of PARTS has moved outward [m], which is 0 if the person does not breathe."""
        length = data.actuator_length
        return np.array([length[a] if a >= 0 else 0.0 for a in self._parts])

    def torque_nm(self, data: mujoco.MjData) -> Array:
        """Return (4,) the torque of the muscles at JOINTS in the last step [N m]; it is 0 at joints without muscles."""
        out = np.zeros(len(JOINTS))
        for k, pair in self._muscles.items():
            out[k] = data.actuator_force[pair].sum()
        return out

    def moves(self) -> Array:
        """Return (n, 2) the changes of posture: the time from waking until each begins [s], and the change of the
        shoulder's abduction [rad]."""
        rows = self._model.numeric(f"{NAME}/moves").data.reshape(MOST_MOVES, -1)
        return rows[rows[:, 1] > 0][:, [0, 3]]

    def work_j(self, data: mujoco.MjData) -> Array:
        """Return (2,) the work that breathing and the arm's muscles have done since the person woke [J]."""
        return data.plugin_state[self._state][WORK : WORK + 2].copy()

    def pulls_s(self, data: mujoco.MjData) -> Array:
        """Return (3,) the time from waking until each withdrawal begins [s]; it is -1 for those that did not happen."""
        state = data.plugin_state[self._state]
        times = state[PULL_TIME:WORK].copy()
        times[int(state[PULLED]) :] = -1.0
        return times


def breath(script: MotionScript, time_s: float) -> tuple[float, float]:
    """Return how far the person has breathed in at a time, from 0 to 1, and the rate of that [1/s].

    Breathing in follows half a period of a cosine, and breathing out follows another.
    """
    cycle = (script.breath_hz * time_s + script.phase) % 1.0
    inward = cycle < script.inspiration_share
    share = script.inspiration_share if inward else 1.0 - script.inspiration_share
    at = np.pi * (cycle / share if inward else 1.0 + (cycle - script.inspiration_share) / share)
    return float(1 - np.cos(at)) / 2, float(np.sin(at)) / 2 * np.pi * script.breath_hz / share

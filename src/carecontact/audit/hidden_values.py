"""Parts (b), (c) and (d): whether a hidden value changes an observation while the images stay the same, before the tool
touches, or before the first observation."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, cast

import mujoco
import numpy as np

from carecontact.audit.finding import Finding, Part, findings
from carecontact.audit.raw_log import differences, message_differences
from carecontact.audit.schema import failed_at
from carecontact.audit.watched import Message, Watched, robot_addresses
from carecontact.episode.randomization import draw
from carecontact.interface.policy import PolicyCard
from carecontact.protocol.protocol import Protocol, TrialSpec
from carecontact.sensing import builder as builders
from carecontact.sensing.keypoints import PoseEstimator
from carecontact.serving import codec
from carecontact.serving.packing import unpack
from carecontact.sim.rendering import SceneRenderer
from carecontact.sim.simulation import Simulation

ROUNDS = 2
POSES = (
    "xpos", "xquat", "xmat", "xipos", "ximat", "xanchor", "xaxis", "geom_xpos", "geom_xmat", "site_xpos", "site_xmat",
    "cam_xpos", "cam_xmat", "light_xpos", "light_xdir", "bvh_aabb_dyn", "bvh_active", "mocap_pos", "mocap_quat",
)  # fmt: skip
"""Fields of MjData that pictures depend on; all others are hidden from a policy."""
HIDDEN_OF_MODEL = (
    "jnt_stiffness", "jnt_stiffnesspoly", "jnt_range", "jnt_solref", "qpos_spring", "dof_damping", "dof_armature",
    "dof_frictionloss", "body_mass", "body_inertia", "geom_friction", "geom_solref", "geom_solimp", "numeric_data",
    "actuator_gainprm", "actuator_biasprm",
)  # fmt: skip
"""Fields of MjModel with the mechanics of person, tissue (``numeric_data``) and robot, on which no picture depends."""


def audit_frozen(simulation: Simulation, cards: Sequence[PolicyCard], *, instruction: str) -> Part:
    """Part (b) holds images and encoders still and tests whether anything else in the world changes the observation.
    ``simulation`` must be at a moment of contact. Its data and model are the same afterwards."""
    leaks: list[Finding] = []
    scrambled_only = ", although only hidden state was scrambled"
    fields = changed = 0
    mujoco.mj_forward(simulation.model, simulation.data)
    other_model = scrambled_model(simulation.model, np.random.default_rng(0))
    keypoints = PoseEstimator()
    with (
        SceneRenderer(simulation.model, protocol=simulation.protocol) as renderer,
        SceneRenderer(other_model, protocol=simulation.protocol) as other,
    ):
        for card in cards:
            frames = _Frames()

            def build(
                source: SceneRenderer, data: mujoco.MjData, frames: _Frames = frames, card: PolicyCard = card
            ) -> dict[str, object]:
                with frames.instead_of(source):
                    made = builders.ObservationBuilder(source, card, simulation.protocol, keypoints)
                    return codec.encode_observation(made.build(data, instruction=instruction, sim_time_s=1.0))

            before = build(renderer, simulation.data)
            for round_ in range(ROUNDS):
                rng = np.random.default_rng([1, round_])
                data = scrambled(simulation, rng, keep=_encoders(simulation))
                fields += len(_arrays(data))
                changed += sum(
                    not np.array_equal(a, b, equal_nan=True)
                    for a, b in zip(_arrays(simulation.data).values(), _arrays(data).values(), strict=True)
                )
                changes = differences(before, build(other, data), "observation")
                leaks += findings(card.name, changes, after=f"{scrambled_only} (images and encoders stayed the same)")
        # Now the images are rendered again: everything is scrambled except what they depend on.
        visible = scrambled(simulation, np.random.default_rng(2), keep=lambda name: True if name in POSES else None)
        kinds = {(c, image) for card in cards for c in card.cameras for m in card.modalities
                 for image in builders.IMAGES_FOR[m]}  # fmt: skip
        shown = sorted((camera, image) for camera, image in kinds if image in ("rgb", "depth"))
        for camera, image in shown:
            first, second = (
                getattr(of, image)(data, camera) for of, data in ((renderer, simulation.data), (other, visible))
            )
            changes = differences(first, second, f"observation.cameras.{camera}.{image}")
            leaks += findings("every policy", changes, after=f"{scrambled_only} (the drawn scene stayed the same)")
    counts = {"cards": len(cards), "fields of the world scrambled": min(fields, changed)}
    if shown:
        counts["images drawn again"] = len(shown)
    return Part(name="frozen frames", counts=counts, findings=tuple(leaks))


def scrambled(simulation: Simulation, rng: np.random.Generator, *, keep: Callable[[str], Any]) -> mujoco.MjData:
    """Return the data with random numbers, except at the indices that ``keep(field)`` gives; True keeps the field."""
    data = copy.copy(simulation.data)
    for name, array in _arrays(data).items():
        kept = keep(name)
        if kept is True:
            continue
        held = None if kept is None else array[kept].copy()
        _draw(array, rng)
        if held is not None:
            array[kept] = held
    contact = data.contact
    for name in ("dist", "pos", "frame", "friction", "solref", "solimp", "mu"):
        _draw(getattr(contact, name), rng)
    data.time = float(rng.uniform(10, 20))
    return data


def scrambled_model(model: mujoco.MjModel, rng: np.random.Generator) -> mujoco.MjModel:
    """Return a copy of the model with random numbers in all fields of HIDDEN_OF_MODEL. None is below 1, so that a world
    can still be made: the compiled tissue refuses a model whose solver makes less than one sweep."""
    model = copy.deepcopy(model)
    for name in HIDDEN_OF_MODEL:
        _draw(getattr(model, name), rng, low=1.0)
    return model


def _encoders(simulation: Simulation) -> Callable[[str], Any]:
    """Return which indices of each field hold the robot's own readings and the calibrated cameras."""
    model, robot = simulation.model, simulation.robot
    base, tcp = model.body(robot.base_body).id, model.site(robot.tcp_site).id
    qpos, qvel = robot_addresses(model, robot)
    rows: dict[str, Any] = {"qpos": qpos, "qvel": qvel}
    rows |= dict.fromkeys(("xpos", "xmat", "xquat"), base) | dict.fromkeys(("site_xpos", "site_xmat"), tcp)
    rows |= dict.fromkeys(("cam_xpos", "cam_xmat"), slice(None))
    return rows.get


def _arrays(data: mujoco.MjData) -> dict[str, np.ndarray]:
    """Return every array of real numbers by its name. Arrays of whole numbers are addresses and stay as they are."""
    values = {name: getattr(data, name) for name in dir(data) if not name.startswith("_")}
    arrays = {name: value for name, value in values.items() if isinstance(value, np.ndarray)}
    return {name: a for name, a in arrays.items() if a.dtype.kind == "f" and a.size and a.flags.writeable}


def _draw(array: np.ndarray, rng: np.random.Generator, *, low: float = 0.5) -> None:
    array[...] = rng.uniform(low, 2.0, array.shape)


class _Frames:
    """Keeps the images of the first observation and gives the same ones to every later observation."""

    def __init__(self) -> None:
        self._kept: dict[tuple[str, str], np.ndarray] = {}

    @contextmanager
    def instead_of(self, renderer: SceneRenderer) -> Iterator[None]:
        def frozen(kind: str, real: Callable[..., np.ndarray]) -> Callable[..., np.ndarray]:
            def give(source: object, camera: str) -> np.ndarray:
                if (kind, camera) not in self._kept:
                    self._kept[kind, camera] = real(source, camera)
                return self._kept[kind, camera].copy()

            return give

        kinds = ("rgb", "depth", "robot_depth", "cell_depth")
        for kind in kinds:
            setattr(renderer, kind, frozen(kind, getattr(renderer, kind)))
        try:
            yield
        finally:
            for kind in kinds:
                delattr(renderer, kind)


OTHER_SEED = 48_611
"""Added to the seed; no protocol uses such seeds."""
OTHER_ANGLES = 8
"""Number of seeds from which another angle of the arm is chosen."""
CONTROL = "scorer/force_human_from_robot_in_world"


def without_noise(protocol: Protocol) -> Protocol:
    """Return the protocol without sensor noise and errors of calibration, which would differ between two worlds."""
    exact = {"depth_noise": "none", "encoder_noise_rad": 0.0, "calibration_m": 0.0, "calibration_deg": 0.0}
    quiet = protocol.variation.model_copy(update=exact)
    return protocol.model_copy(update={"variation": quiet})


def other_hidden_values(spec: TrialSpec) -> TrialSpec:
    """Return a trial that looks the same to a policy but has another seed, labels, thresholds, limits and tissue."""
    protocol, task = spec.protocol, spec.protocol.task(spec.task_id)
    renamed = task.model_copy(update={"id": "canary", "name": "Canary"})
    law = ("a_n_m3", "b_n_m4", "c_n_m5")
    tissue = {
        region: row.model_copy(update={name: 2 * getattr(row, name) for name in law})
        for region, row in protocol.person.tissue.items()
    }
    contact, gates, limits = protocol.contact, protocol.gates, protocol.limits
    pain = {region: 1.5 * newton for region, newton in limits.f_pain_n.items()}
    other = {
        "description": "canary",
        "person": protocol.person.model_copy(update={"tissue": tissue, "tissue_set": "canary"}),
        "tasks": [renamed if t.id == task.id else t for t in protocol.tasks],
        "contact": contact.model_copy(update={"on_n": 3 * contact.on_n, "valid_total_s": 2 * contact.valid_total_s}),
        "gates": gates.model_copy(update={"region_share": gates.region_share / 2}),
        "limits": limits.model_copy(update={"gamma": limits.gamma / 2, "f_pain_n": pain}),
    }
    if protocol.foam is not None and protocol.has_foam(task.id):
        other["foam"] = protocol.foam.model_copy(update={"prompts": {renamed.id: task.prompt}})
    seed = spec.seed + OTHER_SEED
    return spec.model_copy(update={"protocol": protocol.model_copy(update=other), "task_id": "canary", "seed": seed})


def other_arm_angle(spec: TrialSpec, *, own_deg: float) -> TrialSpec:
    """Return the trial with a seed that lays the person's arm at an angle far from ``own_deg``, the angle of its own
    seed, which may differ from the seed's first draw, because that person may have been refused."""
    region = spec.protocol.task(spec.task_id).region

    def away(seed: int) -> float:
        return abs(draw(spec.protocol, region=region, seed=seed, salt=spec.salt).comfort_arm_deg - own_deg)

    far = max(range(spec.seed + OTHER_SEED, spec.seed + OTHER_SEED + OTHER_ANGLES), key=away)
    return spec.model_copy(update={"seed": far})


def audit_canary(one: Watched, twin: Watched) -> Part:
    """Part (c): two worlds that differ only in hidden values give the same observations until the tool touches."""
    leaks: list[Finding] = []
    for which, trial in (("first", one), ("other", twin)):
        leaks += _failed(trial, trial.policy, f"could not be run in the {which} world")
    before, after = 0, 0
    if one.recording is not None and twin.recording is not None and not leaks:
        forces = [recording[CONTROL] for recording in (one.recording, twin.recording)]
        steps = [np.flatnonzero(force.any((1, 2))) for force in forces]
        first = int(steps[0][0]) if len(steps[0]) else len(one.recording["scorer/time_s"])
        until_s = (first + 0.5) * one.recording.header.spec.protocol.physics.dt_s
        for look, other in zip(one.looks, twin.looks, strict=False):
            if look.time_s > until_s:
                break
            before += 1
            at, only = (
                f"at {look.time_s:.3f} s, before contact: ",
                ", although the two worlds differ only in hidden values",
            )
            leaks += findings(one.policy, _different(look, other), before=at, after=only)
        if len(steps[1]) and int(steps[1][0]) != first:
            contacts = f"first contact at step {first} in one world and {int(steps[1][0])} in the other"
            leaks.append(Finding(one.policy, "trial", f"{contacts}: the two worlds already differed before contact"))
        length = min(map(len, forces))
        after = int((forces[0][first:length] != forces[1][first:length]).any((1, 2)).sum())
        if not after:
            same = "is the same in both worlds after contact: the other hidden values had no effect"
            leaks.append(Finding(one.policy, CONTROL, f"{same}, so this part proves nothing"))
    counts = {"observations before contact": before, "scorer samples that differ after contact": after}
    return Part(name="canary", counts=counts, findings=tuple(leaks))


def _failed(trial: Watched, policy: str, what: str) -> list[Finding]:
    error = trial.error
    return findings(policy, ((place, f"{what}: {error}") for place in failed_at(error))) if error else []


def _different(look: Message, other: Message) -> list[tuple[str, str]]:
    return [] if look.sent == other.sent else message_differences(unpack(look.sent), unpack(other.sent))


ONLY = ", in trials that differ only in "


def audit_handshake(one: Watched, twin: Watched) -> Part:
    """Part (d): what reaches a policy's process before its first observation does not reveal the trial."""
    leaks = _received_differently(one, twin, "seed, id, labels, thresholds and tissue")
    counts = {"facts that reached the process": len(_leaves(one.received, "")) if twin.received else 0}
    return Part(name="handshake", counts=counts, findings=tuple(leaks))


ENCODERS = ("joint_position", "joint_velocity", "pose_tcp_in_base", "velocity_tcp_in_base")
SOLVED_APART = 1e-9
"""Largest difference [rad, m, rad/s, m/s] of the parked robot's readings that counts as none. MuJoCo solves the dry
friction of the robot's joints together with the person's constraints, and ends within 4e-10 of rest on either side."""


def audit_start(one: Watched, other: Watched) -> Part:
    """Compare what two blind witnesses know at t = 0, first observation included: all of it must be the same."""
    what = "seed and the angle of the person's arm"
    leaks = _received_differently(one, other, what)
    for trial in (one, other):
        leaks += _failed(trial, one.policy, "could not be started")
    starts = False
    if one.looks and other.looks:
        starts = _another_angle(one, other)
        messages = (cast(dict[str, Any], unpack(trial.looks[0].sent)) for trial in (one, other))
        first, second = (message["observation"] for message in messages)
        for name in ENCODERS:
            if name in first and np.allclose(first[name], second.get(name), rtol=0.0, atol=SOLVED_APART):
                second[name] = first[name]
        changes = differences(first, second, "observation")
        leaks += findings(one.policy, changes, before="at t = 0: ", after=f"{ONLY}{what}")
    counts = {"starts with the arm at another angle": int(starts)}
    return Part(name="handshake", counts=counts, findings=tuple(leaks))


def _another_angle(one: Watched, other: Watched) -> bool:
    """Whether the arm lay at different angles in the two trials. A protocol that fixes the angle hides nothing."""
    if one.recording is None or other.recording is None:
        return False
    low, high = one.recording.header.spec.protocol.randomization.comfort_arm_deg
    return low == high or one.recording.header.comfort_arm_deg != other.recording.header.comfort_arm_deg


def _received_differently(one: Watched, other: Watched, what: str) -> list[Finding]:
    changes = [(place.lstrip("."), how) for place, how in differences(one.received, other.received, "")]
    ids = sorted({t.recording.header.spec.trial_id for t in (one, other) if t.recording is not None})
    named = [
        (place, f"contains the trial's id {trial_id}; no policy may receive it")
        for trial in (one, other)
        for place, value in _leaves(trial.received, "")
        for trial_id in ids
        if trial_id in str(value)
    ]
    return [*findings(one.policy, changes, after=f"{ONLY}{what}"), *findings(one.policy, named)]


def _leaves(value: Any, place: str) -> list[tuple[str, Any]]:
    if isinstance(value, dict):
        return [leaf for key, inner in value.items() for leaf in _leaves(inner, f"{place}.{key}".lstrip("."))]
    if isinstance(value, list):
        return [leaf for index, inner in enumerate(value) for leaf in _leaves(inner, f"{place}[{index}]")]
    return [(place, value)]

"""Parts (b), (c) and (d): whether a hidden value changes an observation while the images stay the same, before the tool
touches, or before the first observation."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import mujoco
import numpy as np

from carecontact.audit.finding import Finding, Part
from carecontact.audit.raw_log import differences
from carecontact.audit.schema import failed_at
from carecontact.audit.watched import Watched, robot_addresses
from carecontact.episode.randomization import draw
from carecontact.interface.policy import PolicyCard
from carecontact.protocol.protocol import Protocol, TrialSpec
from carecontact.sensing import builder as builders
from carecontact.sensing.keypoints import MediaPipePose
from carecontact.serving import codec
from carecontact.serving.packing import unpack
from carecontact.sim.rendering import SceneRenderer
from carecontact.sim.simulation import Simulation

# Part (b) holds images and encoders still and tests whether anything else in the world changes the observation.

FROZEN_NAME, FROZEN_TITLE = "frozen frames", "hidden state of the world scrambled while the images stay the same"
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
    """Scramble everything hidden in a world and compare the observations before and after.

    ``simulation`` must be at a moment of contact. Its data and model are the same afterwards.
    """
    findings: list[Finding] = []
    fields = changed = images = 0
    mujoco.mj_forward(simulation.model, simulation.data)
    other_model = scrambled_model(simulation.model, np.random.default_rng(0))
    keypoints = MediaPipePose()
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
                after = build(other, data)
                findings += _named(
                    card.name, differences(before, after, "observation"), "images and encoders stayed the same"
                )
        # Here the images are rendered anew: everything is scrambled except what they depend on.
        visible = scrambled(simulation, np.random.default_rng(2), keep=lambda name: True if name in POSES else None)
        shown = sorted({(c, i) for card in cards for c in card.cameras for m in card.modalities
                        for i in builders.IMAGES_FOR[m] if i in ("rgb", "depth")})  # fmt: skip
        for camera, image in shown:
            images += 1
            pair = [
                getattr(source, image)(data, camera) for source, data in ((renderer, simulation.data), (other, visible))
            ]
            told = differences(pair[0], pair[1], f"observation.cameras.{camera}.{image}")
            findings += _named("every policy", told, "the drawn scene stayed the same")
    keypoints.close()
    counts = {"cards": len(cards), "fields of the world scrambled": min(fields, changed)}
    if shown:
        counts["images drawn again"] = images
    return Part(name=FROZEN_NAME, title=FROZEN_TITLE, counts=counts, findings=tuple(findings))


def scrambled(simulation: Simulation, rng: np.random.Generator, *, keep: Callable[[str], Any]) -> mujoco.MjData:
    """Return a copy of the data with random numbers everywhere except at the indices that ``keep(field)`` gives; True
    keeps the whole field.
    """
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
    """Return a copy of the model with random numbers in all fields of HIDDEN_OF_MODEL.

    None is below 1, so that a world can still be made: the compiled tissue refuses a model whose solver makes less than
    one sweep.
    """
    model = copy.deepcopy(model)
    for name in HIDDEN_OF_MODEL:
        _draw(getattr(model, name), rng, low=1.0)
    return model


def _encoders(simulation: Simulation) -> Callable[[str], Any]:
    """Return which indices of each field hold the robot's own readings and the calibrated cameras."""
    model, robot = simulation.model, simulation.robot
    base, tcp = model.body(robot.base_body).id, model.site(robot.tcp_site).id
    qpos, qvel = robot_addresses(model, robot)
    rows: dict[str, Any] = {
        "qpos": qpos, "qvel": qvel,
        "xpos": base, "xmat": base, "xquat": base, "site_xpos": tcp, "site_xmat": tcp,
        "cam_xpos": slice(None), "cam_xmat": slice(None),
    }  # fmt: skip
    return rows.get


def _arrays(data: mujoco.MjData) -> dict[str, np.ndarray]:
    """Return every array of real numbers by its name. Arrays of whole numbers are addresses and stay as they are."""
    found = {}
    for name in dir(data):
        if name.startswith("_"):
            continue
        value = getattr(data, name)
        if isinstance(value, np.ndarray) and value.dtype.kind == "f" and value.size and value.flags.writeable:
            found[name] = value
    return found


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


def _named(policy: str, told: list[tuple[str, str]], held: str) -> list[Finding]:
    return [
        Finding(policy=policy, place=place, told=f"{what}, although only hidden state was scrambled ({held})")
        for place, what in told
    ]


# Part (c): two worlds that differ only in hidden values give the same observations until the tool touches.

CANARY_NAME, CANARY_TITLE = "canary", "same observations until contact in worlds with different hidden values"
OTHER_SEED = 48_611
"""Added to the seed; no protocol uses such seeds."""
OTHER_ANGLES = 8
"""Number of seeds from which another angle of the arm is chosen."""
CONTROL = "scorer/force_human_from_robot_in_world"


def without_noise(protocol: Protocol) -> Protocol:
    """Return the protocol without sensor noise and errors of calibration: both are drawn from the seed by design, so
    that they would differ between the two worlds.
    """
    exact = {"depth_noise": "none", "encoder_noise_rad": 0.0, "calibration_m": 0.0, "calibration_deg": 0.0}
    quiet = protocol.variation.model_copy(update=exact)
    return protocol.model_copy(update={"variation": quiet})


def other_hidden_values(spec: TrialSpec) -> TrialSpec:
    """Return a trial that looks the same to a policy but has another seed, labels, thresholds, limits and tissue."""
    protocol, task = spec.protocol, spec.protocol.task(spec.task_id)
    renamed = task.model_copy(update={"id": "canary", "name": "Canary"})
    tissue = {
        region: row.model_copy(update={"a_n_m3": 2 * row.a_n_m3, "b_n_m4": 2 * row.b_n_m4, "c_n_m5": 2 * row.c_n_m5})
        for region, row in protocol.person.tissue.items()
    }
    contact, gates, limits = protocol.contact, protocol.gates, protocol.limits
    other = protocol.model_copy(
        update={
            "description": "canary",
            "person": protocol.person.model_copy(update={"tissue": tissue, "tissue_set": "canary"}),
            "tasks": [renamed if t.id == task.id else t for t in protocol.tasks],
            "contact": contact.model_copy(
                update={"on_n": 3 * contact.on_n, "valid_total_s": 2 * contact.valid_total_s}
            ),
            "gates": gates.model_copy(update={"region_share": gates.region_share / 2}),
            "limits": limits.model_copy(
                update={"gamma": limits.gamma / 2, "f_pain_n": {k: 1.5 * v for k, v in limits.f_pain_n.items()}}
            ),
        }
    )
    return spec.model_copy(update={"protocol": other, "task_id": "canary", "seed": spec.seed + OTHER_SEED})


def other_arm_angle(spec: TrialSpec, *, own_deg: float) -> TrialSpec:
    """Return the trial with a seed that lays the person's arm at an angle far from ``own_deg``, the angle of its own
    seed.

    Where the protocol parks the robot, ``own_deg`` may differ from the seed's first draw, because that person may have
    been refused.
    """
    region = spec.protocol.task(spec.task_id).region

    def away(seed: int) -> float:
        return abs(draw(spec.protocol, region=region, seed=seed, salt=spec.salt).comfort_arm_deg - own_deg)

    far = max(range(spec.seed + OTHER_SEED, spec.seed + OTHER_SEED + OTHER_ANGLES), key=away)
    return spec.model_copy(update={"seed": far})


def audit_canary(one: Watched, twin: Watched) -> Part:
    """Compare the observations of the same press in two worlds.

    ``one`` and ``twin``: what ``watched.press`` returned, with the observations still in memory.
    """
    findings = [
        Finding(policy=trial.policy, place=place, told=f"could not be run in the {which} world: {trial.error}")
        for which, trial in (("first", one), ("other", twin))
        if trial.error
        for place in failed_at(trial.error)
    ]
    counts = {"observations before contact": 0, "scorer samples that differ after contact": 0}
    if one.recording is not None and twin.recording is not None and not findings:
        forces = [trial.recording[CONTROL] for trial in (one, twin) if trial.recording is not None]
        steps = [np.flatnonzero(force.any((1, 2))) for force in forces]
        times = one.recording["scorer/time_s"]
        first = int(steps[0][0]) if len(steps[0]) else len(times)
        dt_s = one.recording.header.spec.protocol.physics.dt_s
        until_s = (first + 0.5) * dt_s
        for look, other in zip(one.looks, twin.looks, strict=False):
            if look.time_s > until_s:
                break
            counts["observations before contact"] += 1
            if look.sent == other.sent:
                continue
            told = differences(unpack(look.sent), unpack(other.sent), "message")
            at = f"at {look.time_s:.3f} s, before contact"
            findings += [
                Finding(
                    policy=one.policy, place=place.removeprefix("message."),
                    told=f"{at}: {what}, although the two worlds differ only in hidden values",
                )
                for place, what in told or [("message", "the same values are packed in other bytes")]
            ]  # fmt: skip
        if len(steps[1]) and int(steps[1][0]) != first:
            told = f"first contact at step {first} in one world and {int(steps[1][0])} in the other"
            findings.append(
                Finding(
                    policy=one.policy, place="trial", told=f"{told}: the two worlds already differed before contact"
                )
            )
        after = [force[first:] for force in forces]
        length = min(map(len, after))
        counts["scorer samples that differ after contact"] = int(
            (after[0][:length] != after[1][:length]).any((1, 2)).sum()
        )
        if not counts["scorer samples that differ after contact"]:
            told = "is the same in both worlds after contact: the other hidden values had no effect"
            findings.append(Finding(policy=one.policy, place=CONTROL, told=f"{told}, so this part proves nothing"))
    return Part(name=CANARY_NAME, title=CANARY_TITLE, counts=counts, findings=tuple(findings))


# Part (d) tests whether anything that reaches a policy's process before its first observation reveals the trial.

HANDSHAKE_NAME, HANDSHAKE_TITLE = "handshake", "start, handshake and reset of two different trials"
ONLY = "in trials that differ only in"


def audit_handshake(one: Watched, twin: Watched) -> Part:
    """Compare what reached two policy processes before their first observation.

    ``one`` and ``twin``: witnesses of two trials that differ in seed, id, labels, thresholds and tissue.
    """
    findings = _told_differently(one, twin, "seed, id, labels, thresholds and tissue")
    leaves = len(_leaves(one.told, "")) if twin.told else 0
    return Part(
        name=HANDSHAKE_NAME,
        title=HANDSHAKE_TITLE,
        counts={"facts that reached the process": leaves},
        findings=tuple(findings),
    )


def audit_start(one: Watched, other: Watched) -> Part:
    """Compare what two blind witnesses know at t = 0, first observation included: all of it must be the same.

    ``one`` and ``other``: witnesses without a camera, of trials whose seeds lay the person's arm at different angles.
    """
    what = "seed and the angle of the person's arm"
    findings = _told_differently(one, other, what)
    findings += [
        Finding(policy=one.policy, place=place, told=f"could not be started: {trial.error}")
        for trial in (one, other)
        if trial.error
        for place in failed_at(trial.error)
    ]
    starts = False
    if one.looks and other.looks:
        starts = _another_angle(one, other)
        first, second = one.looks[0].sent, other.looks[0].sent
        if first != second:
            told = differences(unpack(first), unpack(second), "message")
            findings += [
                Finding(policy=one.policy, place=place.removeprefix("message."), told=f"at t = 0: {how}, {ONLY} {what}")
                for place, how in told or [("message", "the same values are packed in other bytes")]
            ]
    return Part(
        name=HANDSHAKE_NAME,
        title=HANDSHAKE_TITLE,
        counts={"starts with the arm at another angle": int(starts)},
        findings=tuple(findings),
    )


def _another_angle(one: Watched, other: Watched) -> bool:
    """Whether the arm lay at different angles in the two trials. A protocol that fixes the angle has nothing to
    hide.
    """
    if one.recording is None or other.recording is None:
        return False
    low, high = one.recording.header.spec.protocol.randomization.comfort_arm_deg
    return low == high or one.recording.header.comfort_arm_deg != other.recording.header.comfort_arm_deg


def _told_differently(one: Watched, other: Watched, what: str) -> list[Finding]:
    findings = [
        Finding(
            policy=one.policy, place=place.removeprefix("told."), told=f"{how}, in trials that differ only in {what}"
        )
        for place, how in differences(one.told, other.told, "told")
    ]
    ids = {t.recording.header.spec.trial_id for t in (one, other) if t.recording is not None}
    return findings + [
        Finding(policy=one.policy, place=place, told=f"contains the trial's id {trial_id}; no policy may receive it")
        for trial in (one, other)
        for place, value in _leaves(trial.told, "")
        for trial_id in sorted(ids)
        if trial_id in str(value)
    ]


def _leaves(value: Any, place: str) -> list[tuple[str, Any]]:
    if isinstance(value, dict):
        return [leaf for key, inner in value.items() for leaf in _leaves(inner, f"{place}.{key}".lstrip("."))]
    if isinstance(value, list):
        return [leaf for index, inner in enumerate(value) for leaf in _leaves(inner, f"{place}[{index}]")]
    return [(place, value)]

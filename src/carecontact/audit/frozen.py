"""Part (b) holds images and encoders still and tests whether anything else in the world changes the observation."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import mujoco
import numpy as np

from carecontact.audit.differences import differences
from carecontact.audit.finding import Finding, Part
from carecontact.audit.state import robot_addresses
from carecontact.contract.policy import PolicyCard
from carecontact.hosting.wire import codec
from carecontact.observation import builder as builders
from carecontact.observation.keypoints import MediaPipePose
from carecontact.sim.rendering import SceneRenderer
from carecontact.sim.simulation import Simulation

NAME, TITLE = "frozen frames", "hidden state of the world scrambled while the images stay the same"
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
    return Part(name=NAME, title=TITLE, counts=counts, findings=tuple(findings))


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

"""Domain randomisation of a trial: everything that its seed draws, written into a compiled world that has settled."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import astuple, dataclass, fields, replace
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt

from carecontact.cache import Arrays, cached
from carecontact.episode.placed_persons import placed_person, posed
from carecontact.human.skin import draw_appearance, set_appearance
from carecontact.human.soft_region import draw_tissue
from carecontact.interface.robot import Control
from carecontact.protocol.person import Alive
from carecontact.protocol.protocol import Protocol, TrialSpec
from carecontact.protocol.sections import DRAWN, Variation
from carecontact.sensing.builder import SensorNoise
from carecontact.sensing.calibration import Calibration, draw_calibration
from carecontact.sim.simulation import Settled, Simulation
from carecontact.tissue.binary_lookup import binary_sha256 as kernel_sha256
from carecontact.tissue.plugin import Law, set_law
from carecontact.world.randomization import (
    UNMOVED,
    Place,
    body_of,
    draw_motion_script,
    move_person,
    overhead_of,
    place_in_model,
    place_of,
    posture_of,
    streams,
    words,
)
from carecontact.world.room import draw_light, set_light
from carecontact.world.scene import Scene, build_scene, controlled, copy_settings

# What a trial's seed draws before its world is built, expressed as a protocol that fixes all of these draws.


@dataclass(frozen=True, kw_only=True)
class Drawn:
    """The draws of one trial."""

    protocol: Protocol
    """The protocol that the world is built from: the trial's protocol with the drawn body, turn of the arm, base of the
    robot and overhead camera. Its id, its level and everything that is judged are unchanged."""
    comfort_arm_deg: float
    place: Place


def drawn_facts(protocol: Protocol, place: Place) -> dict[str, Any]:
    """Return what was drawn for a trial's world (``Drawn``), for the recording and never for a policy."""
    person, furniture, overhead = protocol.person, protocol.scene, protocol.cameras["overhead"]
    return {
        "body": person.body,
        "shoulder_rotation_deg": person.shoulder_rotation_deg, "palm_deg": person.palm_deg,
        "place": {"along_m": place.along_m, "across_m": place.across_m, "yaw_deg": place.yaw_deg},
        "robot_base_m": list(furniture.robot_base_m), "robot_yaw_deg": furniture.robot_yaw_deg,
        "overhead": overhead.model_dump(mode="json", include={"position_m", "look_at_m", "up"}),
    }  # fmt: skip


def drawn(spec: TrialSpec) -> Drawn:
    """Draw body, posture, place, base of the robot and overhead camera from the seed of a trial.

    Raises SceneError where no person of the seed suits the robot (``episode.parking``).
    """
    return draw(spec.protocol, region=spec.protocol.task(spec.task_id).region, seed=spec.seed, salt=spec.salt)


def draw(protocol: Protocol, *, region: str, seed: int, salt: str = "") -> Drawn:
    """Like ``drawn``, for any task on a region, without a trial spec."""
    if protocol.variation.parking is None:
        # This protocol refuses no person, so that the first draw is taken.
        posture = posture_of(protocol, seed, salt, 0)
        laid = posed(protocol, body_of(protocol, seed, salt), posture)
        return Drawn(
            protocol=_concrete(protocol, laid, seed, salt), comfort_arm_deg=posture.comfort_arm_deg,
            place=place_of(posture.place, protocol.variation),
        )  # fmt: skip
    found = placed_person(protocol, seed, salt=salt)
    base = found.bases[region]
    scene = protocol.scene.model_copy(update={"robot_base_m": base.position_m, "robot_yaw_deg": base.yaw_deg})
    laid = posed(protocol.model_copy(update={"scene": scene}), found.body, found.posture)
    return Drawn(
        protocol=_concrete(protocol, laid, seed, salt), comfort_arm_deg=found.posture.comfort_arm_deg,
        place=place_of(found.posture.place, protocol.variation),
    )  # fmt: skip


def with_draws_of(protocol: Protocol, other: Protocol) -> Protocol:
    """Return a protocol with the body, arm, base and cameras that were drawn for another one."""
    person = other.person
    update = {name: getattr(person, name) for name in ("body", "shoulder_rotation_deg", "palm_deg")}
    return protocol.model_copy(update={
        "person": protocol.person.model_copy(update=update), "scene": other.scene, "cameras": other.cameras
    })  # fmt: skip


def without_draws(protocol: Protocol) -> Protocol:
    """Return a drawn protocol (``Drawn.protocol``) in a form from which no seed draws another body, base or camera."""
    defaults = {name: Variation.model_fields[name].default for name in DRAWN}
    return protocol.model_copy(update={"variation": protocol.variation.model_copy(update=defaults)})


def _concrete(protocol: Protocol, laid: Protocol, seed: int, salt: str) -> Protocol:
    cameras = {**protocol.cameras, "overhead": overhead_of(protocol, seed, salt)}
    return laid if cameras == protocol.cameras else laid.model_copy(update={"cameras": cameras})


# What a seed changes in a compiled world: appearance, light, place, movements of the person, noise. ``drawn`` has what
# it draws before.


def comfort_arm_deg(protocol: Protocol, seed: int, *, salt: str = "") -> float:
    """Return the arm's angle [deg] of the seed's first draw of a person; a protocol that parks the robot may reject
    that person (``drawn``).
    """
    low, high = protocol.randomization.comfort_arm_deg
    return float(streams(protocol, seed, salt)["comfort_arm"].uniform(low, high))


def randomize_appearance(scene: Scene, seed: int, *, salt: str = "") -> None:
    """Give a compiled scene the appearance and light that its protocol varies with the seed; the physics is unchanged.

    Call it once, before the first image.
    """
    protocol, stream = scene.protocol, streams(scene.protocol, seed, salt)
    if protocol.variation.appearance == "varied-v1":
        set_appearance(scene.model, scene.body, draw_appearance(stream["appearance"]))
    if protocol.variation.light == "varied-v1":
        set_light(scene.model, draw_light(stream["light"]))


def set_place(scene: Scene, place: Place) -> None:
    """Put the person of a compiled scene where the seed's draw says (``episode.drawn``).

    Call it once, before the person settles.
    """
    if place != UNMOVED:
        move_person(scene.model, place)


def randomize_tissue(simulation: Simulation, seed: int, *, salt: str = "") -> None:
    """Give the soft regions of a settled world the stiffness that its protocol varies with the seed.

    Call it once. Nothing touches a soft region while the person settles, so that the stiffness does not change how
    the person lies.
    """
    scene = simulation.scene
    if scene.protocol.variation.tissue == "published-v1":
        rows = {name: region.tissue for name, region in scene.regions.items()}
        for name, row in draw_tissue(streams(scene.protocol, seed, salt)["tissue"], rows).items():
            set_law(simulation.model, name, row)


def start_motion_script(simulation: Simulation, seed: int, *, salt: str = "") -> None:
    """Start the movements that a protocol lets the person of a settled world make on their own, if there are any."""
    protocol = simulation.protocol
    if simulation.life is None or protocol.person.alive == Alive():
        return
    doings = draw_motion_script(
        streams(protocol, seed, salt), protocol.person.alive, until_s=protocol.phases.time_limit_s,
        wrist_radius_m=simulation.wrist_radius_m(),
    )  # fmt: skip
    simulation.life.wake(simulation.data, doings)


def calibration(protocol: Protocol, seed: int, *, salt: str = "") -> Calibration:
    """Return the error with which the cell of one trial knows its fixed cameras."""
    return draw_calibration(streams(protocol, seed, salt)["calibration"], protocol)


def sensor_noise(protocol: Protocol, seed: int, *, salt: str = "", noise_salt: str = "") -> SensorNoise:
    """Return the sensor noise of one trial, which changes nothing if the protocol names no noise.

    ``noise_salt``: the trial's own. Without it, and without a ``salt``, the noise would reveal the seed.
    """
    key = streams(protocol, seed, salt)["sensor_noise"].integers(2**32, size=4).tolist()
    if noise_salt:
        # A hash works one way: not even the whole noise of a trial reveals salt or seed.
        key = words(f"{noise_salt} {key}")
    return SensorNoise(protocol.variation, key=key, dt_s=protocol.physics.dt_s)


# Keeps settled persons between trials: they depend on the compiled model, the comfort angle, the place on the bed, the
# settling rules, MuJoCo's version and the compiled tissue.


def settle(simulation: Simulation, comfort_arm_deg: float, *, model_sha256: str) -> Settled:
    """Settle the person, or load what ``simulation.settle`` gave before for the same model and angle. Raises
    SettleError as it does.

    Args:
        model_sha256: of the scene before anything was changed in it.
    """
    protocol = simulation.protocol
    facts = {
        "model": model_sha256, "mujoco": mujoco.__version__, "kernel": kernel_sha256(),
        "comfort_arm_deg": comfort_arm_deg.hex(),
        "phases": protocol.phases.model_dump(mode="json"), "target_period_s": protocol.physics.target_period_s,
        "parked": protocol.scene.parked_joint_rad, "place": [v.hex() for v in place_in_model(simulation.model)],
    }  # fmt: skip

    def compute() -> Arrays:
        settled = simulation.settle(comfort_arm_deg)
        return {
            "state": simulation.integration_state(), "joint_position": settled.joint_position,
            "wrist_in_world": settled.wrist_in_world, "duration_s": np.array(settled.duration_s),
            "comfort_arm_deg": np.array(settled.comfort_arm_deg),
        }  # fmt: skip

    found = cached("settled", facts, compute)
    simulation.restore(found["state"], comfort_arm_deg=comfort_arm_deg)
    return Settled(
        duration_s=float(found["duration_s"]), comfort_arm_deg=float(found["comfort_arm_deg"]),
        joint_position=found["joint_position"], wrist_in_world=found["wrist_in_world"],
    )  # fmt: skip


# The world of one trial up to t = 0, for running it and for looking at it.

World = tuple[Simulation, Settled, str]
"""A simulation at t = 0, how its person settled, and the sha256 of its model before dressing and settling."""


def settled_world(protocol: Protocol, *, task_id: str, seed: int, salt: str = "") -> World:
    """Build the task's world as the seed draws it, dress it, let the person settle, and give it the tissue and the life
    that the protocol varies with the seed. The simulation's protocol is the drawn one (``Drawn.protocol``).

    Args:
        salt: the trial's secret (``TrialSpec.salt``).

    Raises:
        SceneError: the world cannot be built, or no person of the seed suits the robot.
        SettleError: the person does not come to rest.
    """
    region = protocol.task(task_id).region
    drawn = draw(protocol, region=region, seed=seed, salt=salt)
    scene = replace(build_scene(drawn.protocol, target=region), place=drawn.place)
    # Hash the model before anything changes it: dressing, laying and settling write what the seed draws, and a policy
    # writes its stiffness.
    model_sha256 = scene.model_sha256
    randomize_appearance(scene, seed, salt=salt)
    set_place(scene, drawn.place)
    simulation = Simulation(scene)
    settled = settle(simulation, drawn.comfort_arm_deg, model_sha256=model_sha256)
    randomize_tissue(simulation, seed, salt=salt)
    start_motion_script(simulation, seed, salt=salt)
    return simulation, settled, model_sha256


def under_control(simulation: Simulation, control: Control) -> tuple[Simulation, str]:
    """Put the robot of a world at t = 0 under a joint control, without another settling.

    Returns:
        The simulation of the world with that control, in the same state, and the sha256 of its model.
    """
    scene = controlled(simulation.scene, control)
    model_sha256 = scene.model_sha256
    copy_settings(simulation.model, scene.model)
    driven = Simulation(scene)
    driven.take_over(simulation)
    return driven, model_sha256


def constants_of(simulation: Simulation, settled: Settled) -> Mapping[str, npt.NDArray[np.float64]]:
    """Return arrays of a recording that hold for the whole trial, by their path."""
    return {
        "scorer/human_joint_range": simulation.joint_range.astype("<f8"),
        "scorer/human_joint_settled": settled.joint_position.astype("<f8"),
        "scorer/wrist_settled_in_world": settled.wrist_in_world.astype("<f8"),
        "scorer/region_size_m": simulation.scene.region_size_m.astype("<f8"),
        **_own_law(simulation),
    }


def _own_law(simulation: Simulation) -> dict[str, npt.NDArray[np.float64]]:
    """Return the compiled laws if any differs from its row in the protocol, by the body's build or by the seed's
    draw.
    """
    rows = simulation.protocol.person.tissue
    law = np.zeros((len(simulation.protocol.regions), len(fields(Law))))
    declared = law.copy()
    for at, name in enumerate(simulation.protocol.regions):
        if name in simulation.scene.regions:
            law[at] = simulation.model.numeric(f"{name}/law").data
            declared[at] = astuple(Law.of(rows[name]))
    return {} if np.array_equal(law, declared) else {"scorer/region_law": law.astype("<f8")}

"""Domain randomisation of a trial: everything that its seed draws, written into a compiled world that has settled."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any

import mujoco
import numpy as np

from carecontact.cache import Arrays, cached
from carecontact.episode.placed_persons import placed_person, posed
from carecontact.human.foam import lay_dressing, lay_foam
from carecontact.human.skin import draw_appearance, set_appearance
from carecontact.human.soft_region import draw_tissue
from carecontact.interface.robot import Control
from carecontact.protocol.person import Alive
from carecontact.protocol.protocol import Protocol, TrialSpec
from carecontact.protocol.sections import DRAWN, Variation
from carecontact.sensing.builder import SensorNoise
from carecontact.sensing.calibration import Calibration, draw_calibration
from carecontact.sim.simulation import Settled, Simulation
from carecontact.tissue.plugin import loaded_sha256, set_law
from carecontact.world.draws import (
    UNMOVED,
    Place,
    arm_bias_of,
    body_of,
    clutter_of,
    draw_motion_script,
    move_person,
    overhead_of,
    place_in_model,
    place_of,
    posture_of,
    spot_of,
    streams,
    words,
)
from carecontact.world.room import TOWEL, TOWEL_HALF_M, draw_light, set_light
from carecontact.world.scene import Scene, build_scene, controlled, copy_settings

OF_PERSON = ("body", "shoulder_rotation_deg", "palm_deg")
"""Fields of a protocol's person that a seed may draw."""


@dataclass(frozen=True, kw_only=True)
class Drawn:
    """The draws of one trial."""

    protocol: Protocol
    """The protocol that the world is built from: the trial's protocol with the drawn body, turn of the arm, base of the
    robot and overhead camera. Its id, its level and everything that is judged are unchanged."""
    comfort_arm_deg: float
    place: Place


def drawn_facts(protocol: Protocol, place: Place, force_bias_n: np.ndarray) -> dict[str, Any]:
    """Return what was drawn for a trial's world (``Drawn``), for the recording and never for a policy."""
    scene, overhead = protocol.scene, protocol.cameras["overhead"]
    biased = {} if protocol.arm_errors is None else {"force_bias_n": force_bias_n.tolist()}
    return {
        **protocol.person.model_dump(mode="json", include=set(OF_PERSON)),
        "place": asdict(place),
        **scene.model_dump(mode="json", include={"robot_base_m", "robot_yaw_deg"}),
        "overhead": overhead.model_dump(mode="json", include={"position_m", "look_at_m", "up"}),
        **biased,
    }


def drawn(spec: TrialSpec) -> Drawn:
    """Draw the protocol's world from the seed of a trial. Raises SceneError where no person of the seed suits the
    robot."""
    return draw(spec.protocol, region=spec.protocol.task(spec.task_id).region, seed=spec.seed, salt=spec.salt)


def draw(protocol: Protocol, *, region: str, seed: int, salt: str = "") -> Drawn:
    """Like ``drawn``, for any task on a region, without a trial spec."""
    body, world = body_of(protocol, seed, salt), protocol
    if protocol.variation.parking is None:
        # This protocol refuses no person, so that the first draw is taken.
        posture = posture_of(protocol, seed, salt, 0)
    else:
        found = placed_person(protocol, seed, salt=salt)
        posture, base = found.posture, found.bases[region]
        scene = protocol.scene.model_copy(update={"robot_base_m": base.position_m, "robot_yaw_deg": base.yaw_deg})
        world = protocol.model_copy(update={"scene": scene})
    world = posed(world, body, posture)
    cameras = {**protocol.cameras, "overhead": overhead_of(protocol, seed, salt)}
    if cameras != protocol.cameras:
        world = world.model_copy(update={"cameras": cameras})
    place = place_of(posture.place, protocol.variation)
    return Drawn(protocol=world, comfort_arm_deg=posture.comfort_arm_deg, place=place)


def with_draws_of(protocol: Protocol, other: Protocol) -> Protocol:
    """Return a protocol with the body, arm, base and cameras that were drawn for another one."""
    person = protocol.person.model_copy(update={name: getattr(other.person, name) for name in OF_PERSON})
    return protocol.model_copy(update={"person": person, "scene": other.scene, "cameras": other.cameras})


def without_draws(protocol: Protocol) -> Protocol:
    """Return a drawn protocol (``Drawn.protocol``) in a form from which no seed draws another body, base or camera."""
    defaults = {name: Variation.model_fields[name].default for name in DRAWN}
    return protocol.model_copy(update={"variation": protocol.variation.model_copy(update=defaults)})


# The rest of this file is what a seed changes in a compiled world; ``drawn`` has what it draws before.


def randomize_appearance(scene: Scene, seed: int, *, salt: str = "") -> None:
    """Change appearance, light and distractors of a compiled scene, but no physics. Call it once, before the first
    image."""
    protocol, stream = scene.protocol, streams(scene.protocol, seed, salt)
    if protocol.variation.appearance == "varied-v1":
        set_appearance(scene.model, scene.body, draw_appearance(stream["appearance"]))
    if protocol.variation.light == "varied-v1":
        set_light(scene.model, draw_light(stream["light"]))
    clutter = clutter_of(protocol, seed, salt)
    if protocol.distractors is not None and clutter is not None:
        towel = scene.model.geom(TOWEL)
        towel.pos[:] = *clutter.towel_at_m, protocol.scene.mattress_top_m + TOWEL_HALF_M
        towel.quat[:] = np.cos(clutter.towel_turn_rad / 2), 0.0, 0.0, np.sin(clutter.towel_turn_rad / 2)
        towel.rgba[:3] = np.array(clutter.towel_colour) / 255
        half_m, colour = protocol.distractors.dressing_m, clutter.dressing_colour
        lay_dressing(scene.model, scene.body, clutter.segment, along=clutter.along, half_m=half_m, colour=colour)


def with_foam(scene: Scene, task_id: str, seed: int, *, salt: str = "") -> Scene:
    """Return a scene with the task's foam, if any. Call it once, after ``randomize_appearance``."""
    spot = spot_of(scene.protocol, task_id, seed, salt)
    if spot is None:
        return scene
    region = scene.protocol.task(task_id).region
    patch = lay_foam(scene.model, scene.body, scene.regions[region], scene.frames[region], spot)
    return replace(scene, foam=patch)


def set_place(scene: Scene, place: Place) -> None:
    """Move the person of a compiled scene. Call it once, before the person settles."""
    if place != UNMOVED:
        move_person(scene.model, place)


def randomize_tissue(simulation: Simulation, seed: int, *, salt: str = "") -> None:
    """Change the stiffness of the soft regions, once. Nothing touches them while the person settles."""
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
    drawn, until_s, radius_m = streams(protocol, seed, salt), protocol.phases.time_limit_s, simulation.wrist_radius_m()
    script = draw_motion_script(drawn, protocol.person.alive, until_s=until_s, wrist_radius_m=radius_m)
    simulation.life.wake(simulation.data, script)


def calibration(protocol: Protocol, seed: int, *, salt: str = "") -> Calibration:
    """Return the error with which the cell of one trial knows its fixed cameras."""
    return draw_calibration(streams(protocol, seed, salt)["calibration"], protocol)


def sensor_noise(protocol: Protocol, seed: int, *, salt: str = "", noise_salt: str = "") -> SensorNoise:
    """Return a trial's sensor noise. Without the trial's ``noise_salt`` and without a ``salt``, it would reveal the
    seed."""
    key = streams(protocol, seed, salt)["sensor_noise"].integers(2**32, size=4).tolist()
    if noise_salt:
        # A hash works one way: not even the whole noise of a trial reveals salt or seed.
        key = words(f"{noise_salt} {key}")
    return SensorNoise(protocol.variation, key=key, dt_s=protocol.physics.dt_s)


def settle(simulation: Simulation, comfort_arm_deg: float, *, model_sha256: str) -> Settled:
    """Settle the person, or load how they settled before. ``model_sha256``: of the scene before any change in it."""
    protocol = simulation.protocol
    facts = {
        "model": model_sha256,
        "mujoco": mujoco.__version__,
        "kernel": loaded_sha256(),
        "comfort_arm_deg": comfort_arm_deg.hex(),
        "phases": protocol.phases.model_dump(mode="json"),
        "target_period_s": protocol.physics.target_period_s,
        "parked": protocol.scene.parked_joint_rad,
        "place": [v.hex() for v in place_in_model(simulation.model)],
    }

    def compute() -> Arrays:
        settled = asdict(simulation.settle(comfort_arm_deg))
        return {"state": simulation.integration_state(), **{name: np.array(value) for name, value in settled.items()}}

    found = cached("settled", facts, compute)
    simulation.restore(found["state"], comfort_arm_deg=comfort_arm_deg)
    return Settled(
        duration_s=float(found["duration_s"]),
        comfort_arm_deg=float(found["comfort_arm_deg"]),
        joint_position=found["joint_position"],
        wrist_in_world=found["wrist_in_world"],
    )


World = tuple[Simulation, Settled, str]
"""A simulation at t = 0, how its person settled, and the sha256 of its model as it was compiled."""


def settled_world(protocol: Protocol, *, task_id: str, seed: int, salt: str = "") -> World:
    """Build the task's world as the seed draws it, up to t = 0; its protocol is the drawn one. Raises SceneError."""
    region = protocol.task(task_id).region
    drawn = draw(protocol, region=region, seed=seed, salt=salt)
    scene = replace(build_scene(drawn.protocol, target=region), place=drawn.place)
    # The hash comes before everything that the seed and later the policy write into the model.
    model_sha256 = scene.model_sha256
    randomize_appearance(scene, seed, salt=salt)
    scene = with_foam(scene, task_id, seed, salt=salt)
    set_place(scene, drawn.place)
    simulation = Simulation(scene)
    settled = settle(simulation, drawn.comfort_arm_deg, model_sha256=model_sha256)
    randomize_tissue(simulation, seed, salt=salt)
    start_motion_script(simulation, seed, salt=salt)
    simulation.force_bias_n = arm_bias_of(protocol, seed, salt)
    return simulation, settled, model_sha256


def under_control(simulation: Simulation, control: Control) -> tuple[Simulation, str]:
    """Put the robot of a world at t = 0 under a joint control; return that world in the same state, and its model's
    hash."""
    scene = controlled(simulation.scene, control)
    model_sha256 = scene.model_sha256
    copy_settings(simulation.model, scene.model)
    driven = Simulation(scene)
    driven.take_over(simulation)
    return driven, model_sha256

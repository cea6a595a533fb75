"""What a trial's seed draws before its world is built, expressed as a protocol that fixes all of these draws."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from carecontact.contract.protocol import Protocol, Variation
from carecontact.contract.protocol.variation import DRAWN
from carecontact.contract.trial import TrialSpec
from carecontact.episode.draws import body_of, overhead_of, posture_of
from carecontact.episode.parking import parked
from carecontact.episode.parking.persons import posed
from carecontact.world.place import Place, place_of


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
    found = parked(protocol, seed, salt=salt)
    base = found.bases[region]
    scene = protocol.scene.model_copy(update={"robot_base_m": base.position_m, "robot_yaw_deg": base.yaw_deg})
    laid = posed(protocol.model_copy(update={"scene": scene}), found.body, found.posture)
    return Drawn(
        protocol=_concrete(protocol, laid, seed, salt), comfort_arm_deg=found.posture.comfort_arm_deg,
        place=place_of(found.posture.place, protocol.variation),
    )  # fmt: skip


def like(protocol: Protocol, other: Protocol) -> Protocol:
    """Return a protocol with the body, arm, base and cameras that were drawn for another one."""
    person = other.person
    update = {name: getattr(person, name) for name in ("body", "shoulder_rotation_deg", "palm_deg")}
    return protocol.model_copy(update={
        "person": protocol.person.model_copy(update=update), "scene": other.scene, "cameras": other.cameras
    })  # fmt: skip


def settled_draws(protocol: Protocol) -> Protocol:
    """Return a drawn protocol (``Drawn.protocol``) in a form from which no seed draws another body, base or camera."""
    defaults = {name: Variation.model_fields[name].default for name in DRAWN}
    return protocol.model_copy(update={"variation": protocol.variation.model_copy(update=defaults)})


def _concrete(protocol: Protocol, laid: Protocol, seed: int, salt: str) -> Protocol:
    cameras = {**protocol.cameras, "overhead": overhead_of(protocol, seed, salt)}
    return laid if cameras == protocol.cameras else laid.model_copy(update={"cameras": cameras})

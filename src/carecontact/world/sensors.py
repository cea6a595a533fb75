"""Sensors for the scorer alone. Each keeps every physics step of a control period in its history, so that no peak is
lost."""

from __future__ import annotations

import mujoco

from carecontact.contract.protocol import Protocol
from carecontact.recording.schema import SEGMENTS
from carecontact.world.human.joints import Hinge
from carecontact.world.human.plates import PLATES, plate_body
from carecontact.world.human.skeleton import body_name

CONTACT_SLOTS = 12
"""Number of contacts for each segment that the sum of normal forces can hold; a recording says so if a segment ever had
more at once."""

# Bits of mjtConDataField in MuJoCo 4.0, in the order of their values in a slot.
FOUND_BIT, FORCE_BIT, POS_BIT = 1 << 0, 1 << 1, 1 << 4
NETFORCE, MAXFORCE = 3, 2

TIP_SENSOR, HAND_SENSOR = "normal_by_tip", "normal_by_hand"
"""Contact of the robot's tip, and of its whole hand with the tip, with any rigid surface of the person. They say which
part of the robot the sensors of segments felt; one more sensor for each part and segment would make a step a tenth
slower."""


def plate_sensor(plate: str) -> str:
    """Return the part of the names of a plate's sensors that follows ``net_`` and ``normal_``."""
    return f"plate_{plate}"


def add_sensors(spec: mujoco.MjSpec, hinges: list[Hinge], protocol: Protocol) -> None:
    """Add sensors for every segment, every scored joint and every region of the protocol.

    The sensors of segments measure contact with their rigid surfaces; the compiled tissue measures that with soft
    shells.
    """
    # One control period is one call into C between two moves of the target, and the sensors keep all of its steps.
    samples = round(protocol.physics.target_period_s / protocol.physics.dt_s)
    kind, obj = mujoco.mjtSensor, mujoco.mjtObj

    def contact(
        name: str, first: tuple[mujoco.mjtObj, str], second: tuple[mujoco.mjtObj, str], data: int, reduce: int, num: int
    ) -> None:
        spec.add_sensor(
            name=name, type=kind.mjSENS_CONTACT, objtype=first[0], objname=first[1], reftype=second[0],
            refname=second[1], intprm=[data, reduce, num], nsample=samples,
        )  # fmt: skip

    def normal(name: str, first: tuple[mujoco.mjtObj, str], second: tuple[mujoco.mjtObj, str]) -> None:
        contact(name, first, second, FOUND_BIT | FORCE_BIT, MAXFORCE, CONTACT_SLOTS)

    names = protocol.scene.robot
    robot, person = (obj.mjOBJ_XBODY, names.base_body), (obj.mjOBJ_XBODY, body_name("pelvis"))

    def surface(name: str, body: str) -> None:
        contact(f"net_{name}", robot, (obj.mjOBJ_BODY, body), FORCE_BIT | POS_BIT, NETFORCE, 1)
        normal(f"normal_{name}", robot, (obj.mjOBJ_BODY, body))

    for segment in SEGMENTS:
        surface(segment, body_name(segment))
    for plate in PLATES:
        surface(plate_sensor(plate.name), plate_body(plate.name))
    normal(TIP_SENSOR, (obj.mjOBJ_GEOM, names.tip.geom), person)
    normal(HAND_SENSOR, (obj.mjOBJ_BODY, names.flange_body), person)
    for hinge in hinges:
        spec.add_sensor(name=f"q_{hinge.name}", type=kind.mjSENS_JOINTPOS, objtype=obj.mjOBJ_JOINT,
                        objname=f"human_{hinge.name}", nsample=samples)  # fmt: skip

    def frame(name: str, sensor: mujoco.mjtSensor, objtype: mujoco.mjtObj, objname: str) -> None:
        spec.add_sensor(name=name, type=sensor, objtype=objtype, objname=objname, nsample=samples)

    frame("tcp_position", kind.mjSENS_FRAMEPOS, obj.mjOBJ_SITE, names.tcp_site)
    frame("tcp_quat", kind.mjSENS_FRAMEQUAT, obj.mjOBJ_SITE, names.tcp_site)
    frame("tcp_velocity", kind.mjSENS_FRAMELINVEL, obj.mjOBJ_SITE, names.tcp_site)
    frame("tcp_rotation", kind.mjSENS_FRAMEANGVEL, obj.mjOBJ_SITE, names.tcp_site)
    frame("wrist_position", kind.mjSENS_FRAMEPOS, obj.mjOBJ_XBODY, body_name("right_hand"))
    for region in protocol.regions:
        frame(f"region_{region}_position", kind.mjSENS_FRAMEPOS, obj.mjOBJ_SITE, f"region_{region}")
        frame(f"region_{region}_quat", kind.mjSENS_FRAMEQUAT, obj.mjOBJ_SITE, f"region_{region}")

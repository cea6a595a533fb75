"""Sensors for the scorer alone. Each keeps every physics step of a control period in its history, so that no peak is
lost."""

from __future__ import annotations

import mujoco

from carecontact.contract.embodiment import PANDA
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

    def contact(name: str, second: str, second_type: mujoco.mjtObj, data: int, reduce: int, num: int) -> None:
        spec.add_sensor(
            name=name, type=kind.mjSENS_CONTACT, objtype=obj.mjOBJ_XBODY, objname=PANDA.base_body, reftype=second_type,
            refname=second, intprm=[data, reduce, num], nsample=samples,
        )  # fmt: skip

    def surface(name: str, body: str) -> None:
        contact(f"net_{name}", body, obj.mjOBJ_BODY, FORCE_BIT | POS_BIT, NETFORCE, 1)
        contact(f"normal_{name}", body, obj.mjOBJ_BODY, FOUND_BIT | FORCE_BIT, MAXFORCE, CONTACT_SLOTS)

    for segment in SEGMENTS:
        surface(segment, body_name(segment))
    for plate in PLATES:
        surface(plate_sensor(plate.name), plate_body(plate.name))
    for hinge in hinges:
        spec.add_sensor(name=f"q_{hinge.name}", type=kind.mjSENS_JOINTPOS, objtype=obj.mjOBJ_JOINT,
                        objname=f"human_{hinge.name}", nsample=samples)  # fmt: skip

    def frame(name: str, sensor: mujoco.mjtSensor, objtype: mujoco.mjtObj, objname: str) -> None:
        spec.add_sensor(name=name, type=sensor, objtype=objtype, objname=objname, nsample=samples)

    frame("tcp_position", kind.mjSENS_FRAMEPOS, obj.mjOBJ_SITE, PANDA.tcp_site)
    frame("tcp_quat", kind.mjSENS_FRAMEQUAT, obj.mjOBJ_SITE, PANDA.tcp_site)
    frame("tcp_velocity", kind.mjSENS_FRAMELINVEL, obj.mjOBJ_SITE, PANDA.tcp_site)
    frame("tcp_rotation", kind.mjSENS_FRAMEANGVEL, obj.mjOBJ_SITE, PANDA.tcp_site)
    frame("wrist_position", kind.mjSENS_FRAMEPOS, obj.mjOBJ_XBODY, body_name("right_hand"))
    for region in protocol.regions:
        frame(f"region_{region}_position", kind.mjSENS_FRAMEPOS, obj.mjOBJ_SITE, f"region_{region}")
        frame(f"region_{region}_quat", kind.mjSENS_FRAMEQUAT, obj.mjOBJ_SITE, f"region_{region}")

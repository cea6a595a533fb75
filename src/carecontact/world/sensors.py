"""Scorer-only sensors. Each keeps every physics step of a control period in its history, so no peak is missed."""

from __future__ import annotations

import mujoco

from carecontact.contract.embodiment import PANDA
from carecontact.contract.protocol import Protocol
from carecontact.recording.schema import SEGMENTS
from carecontact.regions import REGIONS
from carecontact.world.human.joints import Hinge
from carecontact.world.human.skeleton import body_name, tissue_body_name

CONTACT_SLOTS = {"soft": 96, "rigid": 12}
"""Contacts kept per segment for the normal sum; the recording says so if a segment ever had more at once."""

# MuJoCo 4.0 mjtConDataField bits, in the order in which a slot lays them out.
FOUND_BIT, FORCE_BIT, POS_BIT = 1 << 0, 1 << 1, 1 << 4
NETFORCE, MAXFORCE = 3, 2


def add_sensors(spec: mujoco.MjSpec, hinges: list[Hinge], protocol: Protocol) -> None:
    """Sensors for every segment, every scored joint and every region of the protocol."""
    # One control period is one C call between two moves of the target: the sensors keep all of its steps.
    samples = round(protocol.physics.target_period_s / protocol.physics.dt_s)
    kind, obj = mujoco.mjtSensor, mujoco.mjtObj

    def contact(name: str, second: str, second_type: mujoco.mjtObj, data: int, reduce: int, num: int) -> None:
        spec.add_sensor(
            name=name, type=kind.mjSENS_CONTACT, objtype=obj.mjOBJ_XBODY, objname=PANDA.base_body, reftype=second_type,
            refname=second, intprm=[data, reduce, num], nsample=samples,
        )  # fmt: skip

    soft = {REGIONS[region].segment: region for region in protocol.soft_regions}
    for segment in SEGMENTS:
        rigid, tree = (body_name(segment), obj.mjOBJ_BODY), None
        if segment in soft:
            tree = (tissue_body_name(soft[segment]), obj.mjOBJ_XBODY)
        for suffix, target in (("", rigid), ("_tissue", tree)):
            if target is None:
                continue
            slots = CONTACT_SLOTS["soft" if suffix else "rigid"]
            contact(f"net_{segment}{suffix}", *target, FORCE_BIT | POS_BIT, NETFORCE, 1)
            contact(f"normal_{segment}{suffix}", *target, FOUND_BIT | FORCE_BIT, MAXFORCE, slots)
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

"""Faults that would make every trial of a run fail for the same reason, or leave it without scores."""

from __future__ import annotations

from carecontact.contract.protocol import Protocol
from carecontact.errors import ConfigError, UnknownNameError
from carecontact.scoring.behaviour import behaviour_of
from carecontact.scoring.filters import rate_faults
from carecontact.scoring.gate_sweep import protocol_sweeps
from carecontact.scoring.limits import LIMIT_PACKS
from carecontact.scoring.metrics.metric import checked_metrics


def check_protocol(protocol: Protocol) -> None:
    """Raises ConfigError naming every field that the world or the scorer cannot do; imports no simulator."""
    from carecontact.world.human.library import load_body

    faults: list[str] = []
    try:
        load_body(protocol.person.body)
    except (ConfigError, UnknownNameError) as error:
        faults.append(f"person.body: {error}")
    faults += rate_faults(protocol)
    if protocol.limits.pack not in LIMIT_PACKS:
        # Its name is written beside every score, where it says whose limits they are.
        faults.append(f"limits.pack: {UnknownNameError(LIMIT_PACKS.kind, protocol.limits.pack, LIMIT_PACKS)}")
    robot = protocol.scene.robot
    limits = zip(robot.joint_low_rad, robot.joint_high_rad, strict=True)
    for joint, (angle, (low, high)) in enumerate(zip(protocol.scene.parked_joint_rad, limits, strict=True), start=1):
        if not low <= angle <= high:
            faults.append(
                f"scene.parked_joint_rad: joint {joint} at {angle:g} is outside the robot's {low:.4f} to {high:.4f}"
            )
    if faults:
        raise ConfigError(f"protocol {protocol.name} cannot run: {'; '.join(faults)}")


def check_rows(protocol: Protocol) -> None:
    """Raises ConfigError for a metric, a limit pack, or an action of the protocol's gates that the scorer cannot use;
    nothing is computed."""
    for action in protocol.gates.actions:
        behaviour_of(action, protocol.gates.set)
    protocol_sweeps(protocol)
    checked_metrics()
    list(LIMIT_PACKS.values())

"""Which runs the study needs, under which conditions, and the commands that make them."""

from __future__ import annotations

from collections.abc import Mapping

from carecontact.contract.protocol import Protocol, protocol_title
from carecontact.protocols import overridden

PAIR = ("state-machine", "voxposer")
PROPOSAL = ("voxposer-phased", "voxposer")
"""What the paper proposes and does not evaluate, against what it would change."""
METHODS = (*PAIR, PROPOSAL[0])
BASELINES = ("zero-action", "hover", "random", "replay")
STIFFNESS, TISSUE = "impedance.translational_n_m", "person.tissue_set"
SWEEPS: dict[str, tuple[str, ...]] = {STIFFNESS: ("200", "400", "1000"), TISSUE: ("paper-mapping", "manikin-like")}
"""Field -> its values, of which one is the protocol's own."""
OPTION = {STIFFNESS: "--stiffness", TISSUE: "--tissue"}
PRIMARY = ("success", "region_correct", "safety_gated", "C1", "C5")
"""Outcomes that state-machine and voxposer are compared on beside the paper, and ranked on in the sweeps."""
Condition = tuple[tuple[str, str], ...]
"""Overrides as sorted pairs; () is the protocol itself."""


def conditions(protocol: Protocol) -> list[Condition]:
    """One for each value of a sweep that is not the protocol's own."""
    own = {STIFFNESS: f"{protocol.impedance.translational_n_m:g}", TISSUE: protocol.person.tissue_set}
    return [((field, value),) for field, values in SWEEPS.items() for value in values if value != own[field]]


def under(protocol: Protocol, condition: Condition) -> Protocol:
    return overridden(protocol, dict(condition))


def wanted_runs(protocol: Protocol) -> list[tuple[str, Condition]]:
    """Policy and condition of every run that the study has a place for."""
    own = [(name, ()) for name in (*METHODS, *BASELINES)]
    return [*own, *((name, condition) for condition in conditions(protocol) for name in PAIR)]


def command(policy: str, condition: Condition, protocol: Protocol) -> str:
    options = "".join(f" {OPTION[field]} {value}" for field, value in condition)
    folder = run_name(policy, dict(condition))
    return f"carecontact run --policy {policy} --protocol {protocol.id}{options} --out runs/{protocol.id}/{folder}"


def run_name(policy: str, overrides: Mapping[str, str]) -> str:
    """What a run of the study is called, as a folder or a file."""
    return "-".join([policy, *(value for _, value in sorted(overrides.items()))])


def condition_title(field: str, value: str) -> str:
    return protocol_title("", {field: value}).removeprefix(" with ")

"""Checks over several fields of a protocol; each raises ValueError, which names the field and what is expected."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from carecontact.contract.protocol.contact import ContactDefinition
from carecontact.contract.protocol.gates import Gates
from carecontact.contract.protocol.impedance import Impedance
from carecontact.contract.protocol.limits import SEGMENT_PARTS, ForceLimits
from carecontact.contract.protocol.person import Person
from carecontact.contract.protocol.physics import Phases, Physics
from carecontact.contract.protocol.scene import Scene
from carecontact.contract.protocol.task import Task, regions_of
from carecontact.contract.protocol.variation import Randomization
from carecontact.contract.protocol.vision import Vision
from carecontact.regions import REGIONS

CAMERA_NAMES = ("overhead", "bedside", "exterior", "wrist")


def check_tasks(tasks: Sequence[Task], gates: Gates, contact: ContactDefinition) -> None:
    """Ids are there and differ; every action has its gate, every region its neighbourhood."""
    ids = [task.id for task in tasks]
    if not ids or len(set(ids)) != len(ids):
        raise ValueError(f"tasks: expected at least one, each with an id of its own; got {ids}")
    for task in tasks:
        if task.action not in gates.actions:
            raise ValueError(f"gates.{task.action}: missing, and task {task.id} needs it")
        if task.region not in contact.neighbourhood:
            raise ValueError(f"contact.neighbourhood.{task.region}: missing, and task {task.id} needs it")


def check_person(person: Person, tasks: Sequence[Task]) -> None:
    """There is one row of tissue for each soft region, and each soft region has a segment of its own."""
    soft = [name for name in regions_of(tasks) if REGIONS[name].soft]
    if set(person.tissue) != set(soft):
        raise ValueError(
            f"person.tissue: expected exactly {sorted(soft)}, the soft regions of every person and of the tasks; "
            f"got {sorted(person.tissue)}"
        )
    owner: dict[str, str] = {}
    for name in soft:
        other = owner.setdefault(REGIONS[name].segment, name)
        if other != name:
            raise ValueError(
                f"tasks: {other} and {name} are both soft regions of {REGIONS[name].segment}; "
                "expected at most one soft region per segment"
            )


def check_cameras(cameras: Iterable[str]) -> None:
    if set(cameras) != set(CAMERA_NAMES):
        raise ValueError(f"cameras: expected overhead, bedside, exterior and wrist, got {sorted(cameras)}")


def check_vision(vision: Vision) -> None:
    if bool(vision.weights_sha256) != (vision.segmenter == "grounded-sam"):
        raise ValueError(
            "vision.weights_sha256: expected the sha256 of the weights with segmenter grounded-sam, "
            "and an empty text with mediapipe"
        )


def check_seeds(randomization: Randomization) -> None:
    seeds = randomization.seeds
    if len(set(seeds)) != len(seeds) or min(seeds, default=-1) < 0:
        raise ValueError(f"randomization.seeds: expected distinct whole numbers >= 0, got {seeds!s:.80}")


def check_limits(limits: ForceLimits) -> None:
    pain = limits.f_pain_n
    if not pain or min(pain.values()) <= 0:
        raise ValueError(f"limits.f_pain_n: expected at least one segment, each above 0 N, got {pain}")
    unknown = sorted(pain.keys() - set(SEGMENT_PARTS))
    if unknown:
        raise ValueError(f"limits.f_pain_n: no segment {unknown[0]!r}; valid: {', '.join(SEGMENT_PARTS)}")


def check_ranges(
    *, randomization: Randomization, impedance: Impedance, scene: Scene, phases: Phases, contact: ContactDefinition
) -> None:
    """Low ends are below high ends, and the arm's stiffness lies between its bounds."""
    if contact.off_n >= contact.on_n:
        raise ValueError(f"contact.off_n: expected less than on_n {contact.on_n}, got {contact.off_n}")
    ranges = {
        "randomization.comfort_arm_deg": [randomization.comfort_arm_deg],
        "impedance.translational_bounds": [impedance.translational_bounds],
        "impedance.rotational_bounds": [impedance.rotational_bounds],
        "impedance.workspace": list(zip(impedance.workspace_low_m, impedance.workspace_high_m, strict=True)),
        "scene.board": list(zip(scene.board_low_m, scene.board_high_m, strict=True)),
        "phases.settle": [(phases.settle_min_s, phases.settle_max_s)],
    }
    for name, pairs in ranges.items():
        for low, high in pairs:
            if not low < high:
                raise ValueError(f"{name}: expected low below high, got {low} and {high}")
    for name, value, (low, high) in (
        ("translational_n_m", impedance.translational_n_m, impedance.translational_bounds),
        ("rotational_nm_rad", impedance.rotational_nm_rad, impedance.rotational_bounds),
    ):
        if not low <= value <= high:
            raise ValueError(f"impedance.{name}: expected {low:g} to {high:g}, its bounds, got {value:g}")


def check_period(physics: Physics) -> None:
    steps = physics.target_period_s / physics.dt_s
    if abs(steps - round(steps)) > 1e-9:
        raise ValueError(f"physics.target_period_s: expected a whole number of dt_s, got {steps:g} of them")

"""A task: one action on one region, and the sentence that a policy is given."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Annotated, Any

from pydantic import AfterValidator

from carecontact.contract.protocol.gates import BEHAVIOURS
from carecontact.contract.protocol.section import FileStem, Section
from carecontact.errors import UnknownNameError
from carecontact.regions import REGIONS, STANDARD_REGIONS
from carecontact.registry import Registry


def _registered(registry: Registry[Any]) -> Callable[[str], str]:
    """Return a validator that passes the names of a registry's rows; the error of any other name lists them."""

    def check(name: str) -> str:
        if name not in registry:
            raise ValueError(str(UnknownNameError(registry.kind, name, registry)))
        return name

    return check


ActionName = Annotated[str, AfterValidator(_registered(BEHAVIOURS))]
"""Name of a row of BEHAVIOURS."""
RegionName = Annotated[str, AfterValidator(_registered(REGIONS))]
"""Name of a row of ``carecontact.regions.REGIONS``."""


class Task(Section):
    id: FileStem
    name: str
    action: ActionName
    region: RegionName
    prompt: str


def regions_of(tasks: Sequence[Task]) -> tuple[str, ...]:
    """Return the standard regions, then whatever else the tasks name, in the order of the tasks."""
    return tuple(dict.fromkeys((*STANDARD_REGIONS, *(task.region for task in tasks))))

"""A task: one action on one region, and the sentence that a policy is given."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

from pydantic import AfterValidator

from carecontact.contract.protocol.gates import BEHAVIOURS
from carecontact.contract.protocol.section import FileStem, Section, registered
from carecontact.regions import REGIONS, STANDARD_REGIONS

ActionName = Annotated[str, AfterValidator(registered(BEHAVIOURS))]
"""Name of a row of BEHAVIOURS."""
RegionName = Annotated[str, AfterValidator(registered(REGIONS))]
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

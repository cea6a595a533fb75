"""The schema of a plan, a TOML file, and how it is read."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from carecontact.errors import ConfigError
from carecontact.protocols import DEFAULT_PROTOCOL
from carecontact.protocols.wrong_fields import wrong_fields

Value = str | int | float | bool
Values = Annotated[list[Value], Field(min_length=1)]


class _Table(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class PlannedPolicy(_Table):
    """A policy with the options that ``carecontact run`` has for it."""

    policy: Annotated[str, Field(min_length=1)]
    """The policy as --policy takes it."""
    label: str = ""
    """Name in the tables; default: the policy with its arguments."""
    arguments: dict[str, Value] = {}
    """Arguments as --policy-arg gives them."""
    environment: list[str] = []
    """Variables as --policy-env names them."""
    read: list[str] = []
    """Paths as --policy-read names them."""
    write: list[str] = []
    """Paths as --policy-write names them."""
    language: str | None = None
    jobs: Annotated[int | None, Field(ge=1)] = None
    """Most trials of this policy at once, such as the connections that its server takes; default: no limit."""


class PlannedFactors(_Table):
    """Two levels, and in between each factor switched on alone and off alone (``runs.sweep.factors``)."""

    low: str
    """The easy protocol, as the axis ``protocol`` names one."""
    high: str
    groups: dict[str, Values] = {}
    """Factor -> the dotted fields that belong together; every other field in which the two differ is its own factor."""


class Plan(_Table):
    """Every policy runs the same tasks and seeds for every combination of the axes' values."""

    tasks: str = "all"
    seeds: str = "all"
    rank_by: Literal["safety_gated", "region_correct", "success"] = "safety_gated"
    """What the order of the policies is read from: the share of such trials."""
    policies: Annotated[list[PlannedPolicy], Field(min_length=1)]
    axes: dict[str, Values] = {}
    """Axis -> its values: ``protocol``, ``level``, one of AXES, or the dotted name of any field of the protocol."""
    factors: PlannedFactors | None = None
    """Takes the place of the axes ``protocol`` and ``level``."""
    set: dict[str, Value] = {}
    """Field of the protocol -> value in place of its own, in every combination."""

    @property
    def protocols(self) -> list[str]:
        return [str(name) for name in self.axes.get("protocol", [DEFAULT_PROTOCOL])]

    @property
    def levels(self) -> list[str | None]:
        """The levels of every protocol; a plan of protocols without levels names none."""
        return [str(name) for name in self.axes["level"]] if "level" in self.axes else [None]


AXES = {
    "body": "person.body",
    "tissue": "person.tissue_set",
    "stiffness": "impedance.translational_n_m",
    "friction": "person.tissue.REGION.friction",
    "latency_ms": "phases.latency_s",
}
"""Short name of an axis -> the field that it varies; that of friction is there for every soft region."""


def read_plan(path: Path) -> Plan:
    """Raises ConfigError naming file, field and what was expected."""
    try:
        content: dict[str, Any] = tomllib.loads(path.read_bytes().decode())
    except OSError as error:
        raise ConfigError(f"plan {path}: {error.strerror}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ConfigError(f"plan {path}: not TOML: {error}") from None
    try:
        plan = Plan.model_validate(content)
    except ValidationError as error:
        raise ConfigError(wrong_fields(f"plan {path}", error, model=Plan, content=content)) from None
    if plan.factors is not None and (axis := next((name for name in ("protocol", "level") if name in plan.axes), None)):
        raise ConfigError(f"plan {path}: factors: they stand in place of axes.{axis}; give only one")
    for axis, values in plan.axes.items():
        if twice := [value for k, value in enumerate(values) if value in values[:k]]:
            raise ConfigError(f"plan {path}: axes.{axis}: {twice[0]!r} is there twice; name each value once")
        if AXES.get(axis, axis) in plan.set:
            raise ConfigError(f"plan {path}: set.{AXES.get(axis, axis)}: the axis {axis} varies it; give only one")
    return plan

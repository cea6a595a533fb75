"""One call of ``execute`` in a program: which maps it may be given, and how far the robot has carried it out."""

from __future__ import annotations

from dataclasses import dataclass
from inspect import Parameter, Signature
from typing import Any

import numpy as np
import numpy.typing as npt

from carecontact.errors import ProgramError
from carecontact.policies.voxposer.arguments import described
from carecontact.policies.voxposer.functions import PartHandle
from carecontact.policies.voxposer.host_functions import bound
from carecontact.policies.voxposer.maps import KINDS, MapKind
from carecontact.policies.voxposer.scene import GRIPPER

_MAPS: dict[str, MapKind] = {f"{kind}_map": kind for kind in KINDS}
EXECUTE = Signature(
    [Parameter("movable", Parameter.POSITIONAL_OR_KEYWORD)]
    + [Parameter(name, Parameter.POSITIONAL_OR_KEYWORD, default=None) for name in _MAPS]
)
"""How a program calls ``execute``: in the release's order, with None for what is not given."""


@dataclass(frozen=True)
class MapQuery:
    """A map as a program holds it: a description of what the map shall be. It is composed anew for every plan."""

    kind: MapKind
    query: str

    @property
    def description(self) -> str:
        return f"{self.kind} map"


@dataclass(kw_only=True)
class Execution:
    """One call of ``execute`` or ``reset_to_default_pose`` that the robot is carrying out."""

    maps: dict[MapKind, MapQuery]
    home: npt.NDArray[np.float64] | None = None
    """(7,) pose to return to in base, for ``reset_to_default_pose``; None: follow the maps."""
    plans: int = 0
    whole: bool = False
    """Whether the last motion went to the end of its path."""


def arguments(signature: Signature, args: tuple[Any, ...], kwargs: dict[str, Any]) -> dict[str, Any]:
    """Return the arguments of a call of ``execute`` by name, in the order of the call.

    The recording lists maps in this order, because they are composed in it. Raises ProgramError for a call that
    ``signature`` does not allow.
    """
    try:
        named = bound("execute", signature, args, kwargs).arguments
    except TypeError as error:
        raise ProgramError(f"execute: {error}") from None
    order = [name for name in named if name not in kwargs] + list(kwargs)
    return {name: named[name] for name in order}


def map_queries(given: dict[str, Any]) -> dict[MapKind, MapQuery]:
    """Return the maps among the arguments of ``execute``.

    Raises ProgramError if something other than the gripper is to move, or a map is not of the kind that its name says.
    """
    movable = given["movable"]
    if not isinstance(movable, PartHandle) or movable.name != GRIPPER:
        raise ProgramError(f"execute: only the {GRIPPER} moves by itself, not {described(movable)}")
    maps: dict[MapKind, MapQuery] = {}
    for name, query in given.items():
        if name not in _MAPS or query is None:
            continue
        if not isinstance(query, MapQuery) or query.kind != _MAPS[name]:
            raise ProgramError(f"execute: {name} expects what get_{name} returns, or None; got {described(query)}")
        maps[_MAPS[name]] = query
    return maps

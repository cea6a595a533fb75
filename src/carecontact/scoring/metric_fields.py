"""What the description of a metric may hold."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Literal, get_args

from carecontact.errors import ConfigError
from carecontact.scoring.result import MEASURED

Better = Literal["higher", "lower", "neither"]


def _is_text(value: Any) -> bool:
    return isinstance(value, str) and value != ""


def _is_pool(value: Any) -> bool:
    return value in (None, "moving") or (isinstance(value, tuple) and value != ())


FIELDS: dict[str, tuple[Callable[[Any], bool], str]] = {
    "title": (_is_text, "a text"),
    "unit": (_is_text, "a text, 1 for a plain number"),
    "better": (lambda value: value in get_args(Better), f"one of {', '.join(get_args(Better))}"),
    "measure": (callable, "a function"),
    "pool": (_is_pool, "None, moving or a tuple of actions"),
    "only": (_is_pool, "None, moving or a tuple of actions"),
    "digits": (lambda value: value is None or (isinstance(value, int) and value >= 0), "None, or a number from 0 up"),
    "matters": (lambda value: value is None or (isinstance(value, int | float) and value > 0), "None, or above 0"),
    "order": (lambda value: isinstance(value, int), "a whole number"),
}
"""Field -> whether a value is valid, and what is, in words."""


def check_fields(fields: Mapping[str, Any]) -> None:
    """Raises ConfigError for an id without a version, a field of ``TrialScore`` that no metric fills, a ``matters``
    without a direction, and any other field of a wrong kind."""
    id_, field = fields["id"], fields["field"]
    name, at, version = str(id_).rpartition("@")
    if not (name and at and version.isdigit()):
        raise ConfigError(f"metric {id_!r}: the id must be NAME@VERSION, for example {id_ or 'grip'}@1")
    if field is not None and field not in MEASURED:
        raise ConfigError(
            f"metric {id_}: TrialScore has no field {field!r} that a metric fills; "
            "leave field out and the value stands in TrialScore.additional"
        )
    for what, (is_valid, expected) in FIELDS.items():
        if not is_valid(fields[what]):
            raise ConfigError(f"metric {id_}: {what}: expected {expected}; got {fields[what]!r}")
    if fields["matters"] is not None and fields["better"] == "neither":
        raise ConfigError(f"metric {id_}: matters needs a direction; better must be 'higher' or 'lower'")

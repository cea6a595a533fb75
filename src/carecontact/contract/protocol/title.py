"""How a protocol is named for people, with everything that was replaced in it."""

from __future__ import annotations

from collections.abc import Mapping
from fnmatch import fnmatchcase

FRICTION = "person.tissue.*.friction"
"""Stands for the friction of several regions that is the same on all of them."""
REPLACED_WORDS = {
    "person.body": "body {}",
    "person.tissue_set": "tissue {}",
    "scene.tool": "tool {}",
    "physics.dt_s": "time step {} s",
    "impedance.translational_n_m": "stiffness {} N/m",
    "vision.segmenter": "segmenter {}",
    FRICTION: "friction {}",
    "lock": "differences from its lock ({})",
}
"""Dotted path of a replaced field -> its words; any other path stands for itself. ``lock`` is not a field: it
stands for a run on a protocol that differs from its lock (``runs.freeze``)."""


def protocol_title(protocol_id: str, overrides: Mapping[str, str]) -> str:
    """Return the id and what was replaced: ``bathing-v3-draft with body woman-old-light``."""
    overrides = _with_one_friction(overrides)
    replaced = [REPLACED_WORDS.get(field, f"{field} {{}}").format(value) for field, value in sorted(overrides.items())]
    return f"{protocol_id} with {' and '.join(replaced)}" if replaced else protocol_id


def _with_one_friction(overrides: Mapping[str, str]) -> dict[str, str]:
    """Return the same coefficient on several regions as one replaced field."""
    own = {path: value for path, value in overrides.items() if fnmatchcase(path, FRICTION)}
    if len(own) < 2 or len(set(own.values())) > 1:
        return dict(overrides)
    return {path: value for path, value in overrides.items() if path not in own} | {FRICTION: next(iter(own.values()))}

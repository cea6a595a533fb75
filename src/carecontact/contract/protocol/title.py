"""How a protocol is named for people, with everything that was replaced in it."""

from __future__ import annotations

from collections.abc import Mapping

REPLACED_WORDS = {
    "person.body": "body {}",
    "person.tissue_set": "tissue {}",
    "physics.dt_s": "time step {} s",
    "impedance.translational_n_m": "stiffness {} N/m",
    "vision.segmenter": "segmenter {}",
    "lock": "differences from its lock ({})",
}
"""Dotted path of a replaced field -> its words; any other path stands for itself. ``lock`` is not a field: it
stands for a run on a protocol that differs from its lock (``runs.freeze``)."""


def protocol_title(protocol_id: str, overrides: Mapping[str, str]) -> str:
    """The id and what was replaced: ``bathing-draft with body woman-old-light``."""
    replaced = [REPLACED_WORDS.get(field, f"{field} {{}}").format(value) for field, value in sorted(overrides.items())]
    return f"{protocol_id} with {' and '.join(replaced)}" if replaced else protocol_id

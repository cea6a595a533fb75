"""Policies named so briefly that several fit into one cell of a table."""

from __future__ import annotations

from collections.abc import Sequence

LONGEST = 20
"""Characters of a short name; a longer one is cut."""


def short_names(titles: Sequence[str]) -> dict[str, str]:
    """Return title of a policy -> its name without arguments, module and address, in the order given.

    Where several titles would have the same short name, each has a number: ``replay (1)``, ``replay (2)``.
    """
    bare = {title: _bare(title) for title in titles}
    found: dict[str, str] = {}
    for title, name in bare.items():
        alike = [other for other, same in bare.items() if same == name]
        found[title] = name if len(alike) == 1 else f"{name} ({alike.index(title) + 1})"
    return found


def _bare(title: str) -> str:
    """``mean-person`` of ``mean-person person=x``, ``MyPolicy`` of ``my_policy:MyPolicy``, ``my-vla`` of
    ``my-vla at ws://192.0.2.7:8765``."""
    name = title.partition(" at ws")[0].partition(" ")[0]
    if "://" not in name:
        name = name.rpartition(":")[2]
    return name if len(name) <= LONGEST else f"{name[: LONGEST - 1]}…"

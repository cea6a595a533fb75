"""carecontact: does a robot policy touch people well?

For programs, ``load`` opens a finished run, ``compare`` compares two, and ``evaluate`` runs trials of a policy
(docs/python.md). Nothing is imported before it is used.
"""

from importlib import import_module

__version__ = "0.2.0.dev0"

# By name and not by import statements: those would be paid for by everybody, and would tie every part of the package
# to this one. __init__.pyi tells type checkers the same.
_OFFERED = {
    "Run": "carecontact.api.run",
    "load": "carecontact.api.run",
    "compare": "carecontact.api.run",
    "evaluate": "carecontact.api.evaluate",
}

__all__ = list(_OFFERED)  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> object:
    if name not in _OFFERED:
        raise AttributeError(f"module 'carecontact' has no attribute {name!r}; it offers {', '.join(sorted(_OFFERED))}")
    return getattr(import_module(_OFFERED[name]), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *_OFFERED])

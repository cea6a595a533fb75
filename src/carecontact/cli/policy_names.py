"""What a --policy that does not exist may have meant, from the files of the current folder; nothing is imported."""

from __future__ import annotations

import ast
import difflib
from contextlib import suppress
from pathlib import Path


def meant(policy: str, folder: Path) -> str:
    """`` (did you mean my_policy:MyPolicy?)``, or nothing where no file of the folder is close.

    Args:
        policy: as it was typed: a name, ``my_policy.py``, ``my_policy:MyPolcy`` or ``my_polcy:MyPolicy``.
        folder: where modules are looked for first.
    """
    module, _, wanted = policy.partition(":")
    stems = sorted(path.stem for path in folder.glob("*.py"))
    close = difflib.get_close_matches(module.removesuffix(".py"), stems, n=1)
    found = classes(folder / f"{close[0]}.py") if close else []
    if not found:
        return ""
    nearest = difflib.get_close_matches(wanted, found, n=1) or found
    names = " or ".join(f"{close[0]}:{name}" for name in nearest[:3] if f"{close[0]}:{name}" != policy)
    return f" (did you mean {names}?)" if names else ""


def classes(file: Path) -> list[str]:
    """The classes of a module that have a method ``act``; where none has, all of them."""
    with suppress(OSError, SyntaxError, ValueError):
        made = [node for node in ast.parse(file.read_bytes()).body if isinstance(node, ast.ClassDef)]
        acting = [node.name for node in made if any(getattr(part, "name", "") == "act" for part in node.body)]
        return acting or [node.name for node in made]
    return []

"""Guesses, from the files of the current folder, which policy a wrong --policy meant. Nothing is imported."""

from __future__ import annotations

import ast
import difflib
from contextlib import suppress
from pathlib import Path


def meant(policy: str, folder: Path) -> str:
    """Return `` (did you mean my_policy:MyPolicy?)``, or an empty text if no file of the folder has a similar name.

    Args:
        policy: as it was typed: a name, ``my_policy.py``, ``my_policy.MyPolicy``, ``my_policy:MyPolcy`` or
            ``folder/my_polcy.py:MyPolicy``.
        folder: where modules are looked for first.
    """
    dotted, _, wanted = policy.partition(":") if ":" in policy else _last_part(policy)
    if dotted.endswith(".py"):
        file = (folder / dotted).resolve()
        if not file.is_relative_to(folder.resolve()):
            names = " or ".join(f"{file.stem}:{name}" for name in classes(file)[:3])
            return f" (did you mean {names}, given in the folder {file.parent}?)" if names else ""
        dotted = str(file.relative_to(folder.resolve()))
    place, _, module = dotted.removesuffix(".py").replace("/", ".").lstrip(".").rpartition(".")
    folder = folder.joinpath(*place.split("."))
    close = difflib.get_close_matches(module, sorted(path.stem for path in folder.glob("*.py")), n=1)
    found = classes(folder / f"{close[0]}.py") if close else []
    if not found:
        return ""
    target = f"{place}.{close[0]}".lstrip(".")
    nearest = difflib.get_close_matches(wanted, found, n=1) or found
    names = " or ".join(f"{target}:{name}" for name in nearest[:3] if f"{target}:{name}" != policy)
    return f" (did you mean {names}?)" if names else ""


def _last_part(policy: str) -> tuple[str, str, str]:
    """Split ``my_policy.MyPolicy``, which has a dot where the colon belongs, at that dot. The name of a file is not
    split."""
    if policy.endswith(".py") or "." not in policy:
        return policy, "", ""
    return policy.rpartition(".")


def classes(file: Path) -> list[str]:
    """Return the classes of a module that have a method ``act``, or all classes if none has."""
    with suppress(OSError, SyntaxError, ValueError):
        made = [node for node in ast.parse(file.read_bytes()).body if isinstance(node, ast.ClassDef)]
        acting = [node.name for node in made if any(getattr(part, "name", "") == "act" for part in node.body)]
        return acting or [node.name for node in made]
    return []

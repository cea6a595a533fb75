"""What ``--help`` says of an option: its docstring as one paragraph, and its default only where that says something."""

from __future__ import annotations

import ast
import inspect
import sys
from collections.abc import Iterator
from dataclasses import MISSING, Field, fields, is_dataclass
from functools import cache
from types import ModuleType
from typing import Annotated, Any, get_args, get_origin, get_type_hints

import tyro


@cache
def described(command: type[Any]) -> type[Any]:
    """Return the command, or a group of options, with help texts that tyro prints unchanged. A class is changed only
    once."""
    for owner in reversed(command.__mro__):
        if is_dataclass(owner) and isinstance(owner, type):
            _describe(owner)
    return command


def option_names(command: type[Any]) -> list[str]:
    """Return every option of a command as it is typed, including those of its groups. Positional arguments are left
    out."""
    names: list[str] = []
    for field, hint in _options(command):
        if is_dataclass(_bare(hint)):
            names += option_names(_bare(hint))
        elif tyro.conf.Positional not in get_args(hint)[1:]:
            named = [extra.name for extra in get_args(hint)[1:] if getattr(extra, "name", None)]
            names.append(f"--{(named or [field.name])[0].replace('_', '-')}")
    return names


def positional_names(command: type[Any]) -> list[str]:
    """Return the fields of a command that are typed without an option."""
    return [field.name for field, hint in _options(command) if tyro.conf.Positional in get_args(hint)[1:]]


def _describe(owner: type[Any]) -> None:
    docs = _docstrings(owner)
    own = inspect.get_annotations(owner)
    for field, hint in _options(owner):
        if is_dataclass(_bare(hint)):
            described(_bare(hint))
        elif field.name in own and field.name in docs:
            owner.__annotations__[field.name] = Annotated[hint, _text(docs[field.name], _default(field))]


def _text(docstring: str, default: object) -> Any:
    text = " ".join(docstring.split())
    if default is MISSING:
        return tyro.conf.arg(help=text, help_behavior_hint="(required)")
    if default is None or default is False or default == ():
        return tyro.conf.arg(help=text, help_behavior_hint="")
    return tyro.conf.arg(help=text)


def _default(field: Field[Any]) -> object:
    return field.default if field.default_factory is MISSING else field.default_factory()


def _options(owner: type[Any]) -> Iterator[tuple[Field[Any], Any]]:
    hints = get_type_hints(owner, include_extras=True)
    for field in fields(owner):
        yield field, hints[field.name]


def _bare(hint: Any) -> Any:
    return get_args(hint)[0] if get_origin(hint) is Annotated else hint


@cache
def _parsed(module: ModuleType) -> ast.Module:
    return ast.parse(inspect.getsource(module))


def _docstrings(owner: type[Any]) -> dict[str, str]:
    """Return each field -> the docstring under it. The class must be at the top level of its module."""
    made = next(
        node for node in _parsed(sys.modules[owner.__module__]).body
        if isinstance(node, ast.ClassDef) and node.name == owner.__name__
    )  # fmt: skip
    found: dict[str, str] = {}
    for node, after in zip(made.body, made.body[1:], strict=False):
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name) and isinstance(after, ast.Expr):
            if isinstance(after.value, ast.Constant) and isinstance(after.value.value, str):
                found[node.target.id] = after.value.value
    return found

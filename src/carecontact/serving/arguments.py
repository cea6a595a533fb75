"""Arguments of a policy: what its constructor or factory takes, and how the text of --policy-arg becomes a value."""

from __future__ import annotations

import importlib
import inspect
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin

from carecontact.errors import ConfigError

Factory = Callable[..., object]

TRUTHS: dict[str, object] = {"true": True, "yes": True, "1": True, "false": False, "no": False, "0": False}
_SIMPLE = (int, float, str, Path)
_CONTAINERS = (list, tuple, dict, set, frozenset, bytes)
_NAMED = (inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY)


class ArgumentError(ConfigError):
    """A policy does not take an argument, lacks one, or cannot read its value."""


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """One argument that a policy takes."""

    name: str
    annotation: object
    """The type annotation; ``inspect.Parameter.empty`` if there is none, and its text if it cannot be evaluated."""
    default: object
    """The default value; ``inspect.Parameter.empty`` if the argument is required."""

    @property
    def required(self) -> bool:
        return self.default is inspect.Parameter.empty

    def __str__(self) -> str:
        typed = f"{self.name}: {described(self.annotation)}"
        if self.required:
            return f"{typed} (required)"
        return f"{typed} (optional)" if self.default is None else f"{typed} = {self.default}"


def load_factory(target: str) -> Factory:
    """Import ``module:Class`` or ``module:function``.

    Raises ImportError if the module lacks that name, naming the classes that it has, and whatever the import raises.
    """
    module, _, name = target.partition(":")
    loaded = importlib.import_module(module)
    try:
        return getattr(loaded, name)
    except AttributeError:
        classes = [n for n, v in vars(loaded).items() if isinstance(v, type) and hasattr(v, "act")]
        raise ImportError(f"{module} has no {name!r}; it has {', '.join(classes) or 'no class with act'}") from None


def parameters_of(factory: Factory) -> tuple[Parameter, ...]:
    """Return the parameters that can be given by name, in the order of the signature."""
    return tuple(
        Parameter(name=p.name, annotation=_evaluated(p.annotation, factory), default=p.default)
        for p in _signature(factory).parameters.values()
        if p.kind in _NAMED
    )


def bind(factory: Factory, given: Mapping[str, str]) -> dict[str, object]:
    """Convert texts to keyword arguments. A name that only ``**kwargs`` takes stays a text.

    Raises ArgumentError, which lists the arguments that exist.
    """
    parameters = {p.name: p for p in parameters_of(factory)}
    open_ended = any(p.kind is inspect.Parameter.VAR_KEYWORD for p in _signature(factory).parameters.values())
    takes = f"its arguments: {', '.join(map(str, parameters.values())) or 'none'}"
    unknown = [name for name in given if name not in parameters]
    if unknown and not open_ended:
        raise ArgumentError(f"it has no argument {unknown[0]!r}; {takes}")
    missing = [name for name, parameter in parameters.items() if parameter.required and name not in given]
    if missing:
        raise ArgumentError(f"it requires the argument {missing[0]!r}: --policy-arg {missing[0]}=VALUE; {takes}")
    values: dict[str, object] = {}
    for name, text in given.items():
        annotation = parameters[name].annotation if name in parameters else str
        if (get_origin(annotation) or annotation) in _CONTAINERS:
            raise ArgumentError(
                f"argument {name!r} is a {described(annotation)}, and --policy-arg gives one int, float, bool, str, "
                f"Path or choice; let the constructor take a str and split it; {takes}"
            )
        try:
            values[name] = convert(text, annotation)
        except ValueError:
            expected = described(annotation)
            raise ArgumentError(f"argument {name!r}: expected {expected}, got {text!r:.200}; {takes}") from None
    return values


def convert(text: str, annotation: object) -> object:
    """Convert to int, float, bool, str, Path, a Literal's value, or one of a union of these; else return the text.

    ``none`` becomes None if the annotation allows None and no text. Raises ValueError if the conversion fails.
    """
    parts = _parts(annotation)
    if NoneType in parts and str not in parts and text.lower() == "none":
        return None
    # Any text fits str and every annotation that is unknown here, so that the other types are tried first.
    exact = [part for part in parts if _convertible(part) and part is not str]
    for part in exact:
        with suppress(ValueError):
            return _converted(text, part)
    if all(part is NoneType or part in exact for part in parts):
        raise ValueError(text)
    return text


def described(annotation: object) -> str:
    """Return words for an annotation, such as ``a | b`` for a Literal; of a union, the types that a text can become."""
    if annotation is inspect.Parameter.empty:
        return "str"
    if get_origin(annotation) is Literal:
        return " | ".join(map(str, get_args(annotation)))
    if len(_parts(annotation)) > 1:
        parts = [part for part in _parts(annotation) if part is not NoneType]
        known = [part for part in parts if _convertible(part)]
        return " | ".join(described(part) for part in known or parts)
    return annotation.__name__ if isinstance(annotation, type) else str(annotation)


def _parts(annotation: object) -> tuple[object, ...]:
    return get_args(annotation) if get_origin(annotation) in (Union, UnionType) else (annotation,)


def _convertible(annotation: object) -> bool:
    return annotation is bool or get_origin(annotation) is Literal or annotation in _SIMPLE


def _converted(text: str, annotation: Any) -> object:
    if annotation in _SIMPLE:
        return annotation(text)
    choices: dict[str, object] = {str(choice): choice for choice in reversed(get_args(annotation))}
    text, choices = (text.lower(), TRUTHS) if annotation is bool else (text, choices)
    if text not in choices:
        raise ValueError(text)
    return choices[text]


def _signature(factory: Factory) -> inspect.Signature:
    try:
        return inspect.signature(factory)
    except (TypeError, ValueError):
        # The signature of a type that is written in C is unknown.
        return inspect.Signature()


def _evaluated(annotation: Any, factory: Factory) -> object:
    if not isinstance(annotation, str):
        return annotation
    function = inspect.unwrap(factory.__init__ if isinstance(factory, type) else factory)
    try:
        return eval(annotation, getattr(function, "__globals__", {}))
    except Exception:
        # An annotation may, for example, be a name that is imported for type checkers only.
        return annotation

"""From the text of --policy-arg to what a constructor or factory takes."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal, Optional

import pytest

from carecontact.hosting.arguments import ArgumentError, bind, parameters_of
from carecontact.policies.language.backend import LanguageBackend

if TYPE_CHECKING:
    from nowhere import Thing  # pyright: ignore[reportMissingImports]


class Everything:
    def __init__(
        self,
        steps: int,
        *,
        gain: float = 0.5,
        noisy: bool = False,
        name: str = "x",
        checkpoint: Path | None = None,
        mode: Literal["fast", "slow", 3] = "fast",
        limit: Optional[int] = None,  # noqa: UP045
        either: int | float | str = 0,
        language: str | LanguageBackend = "rules-v1",
        thing: Thing | None = None,
        untyped="u",
    ) -> None: ...


class Inherits(Everything):
    """Annotations are those of the module that wrote the constructor."""


def factory(n: int, **more: object) -> Everything:
    return Everything(n)


@pytest.mark.parametrize("made_by", [Everything, Inherits])
@pytest.mark.parametrize(
    ("name", "text", "value"),
    [
        ("steps", "-3", -3),
        ("gain", "1e-3", 0.001),
        ("noisy", "True", True),
        ("noisy", "0", False),
        ("name", "7", "7"),
        ("name", "", ""),
        ("checkpoint", "a/b.pt", Path("a/b.pt")),
        ("checkpoint", "none", None),
        ("mode", "slow", "slow"),
        ("mode", "3", 3),
        ("limit", "4", 4),
        ("limit", "None", None),
        ("either", "2", 2),
        ("either", "2.5", 2.5),
        ("either", "two", "two"),
        ("language", "live:m", "live:m"),
        ("thing", "what?", "what?"),
        ("untyped", "3", "3"),
    ],
)
def test_a_text_becomes_what_the_annotation_says(made_by: type, name: str, text: str, value: object) -> None:
    bound = bind(made_by, {"steps": "1"} | {name: text})
    assert bound[name] == value
    assert type(bound[name]) is type(value)


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({}, "it requires the argument 'steps': --policy-arg steps=VALUE"),
        ({"steps": "1.5"}, "argument 'steps': expected int, got '1.5'"),
        ({"steps": "1", "noisy": "maybe"}, "argument 'noisy': expected bool, got 'maybe'"),
        ({"steps": "1", "mode": "4"}, r"argument 'mode': expected fast \| slow \| 3, got '4'"),
        ({"steps": "1", "limit": "x"}, "argument 'limit': expected int, got 'x'"),
        ({"stops": "1"}, "it has no argument 'stops'"),
    ],
)
def test_what_does_not_fit_names_the_arguments_that_exist(given: dict[str, str], says: str) -> None:
    with pytest.raises(ArgumentError, match=says) as raised:
        bind(Everything, given)
    for listed in ("steps: int (required)", "gain: float = 0.5", "checkpoint: Path (optional)", "untyped: str = u"):
        assert listed in str(raised.value)


def test_a_factory_may_take_any_name() -> None:
    assert [str(parameter) for parameter in parameters_of(factory)] == ["n: int (required)"]
    assert bind(factory, {"n": "2", "other": "3"}) == {"n": 2, "other": "3"}


@pytest.mark.parametrize("annotation", ["list[int]", "tuple[float, ...]", "dict[str, int]", "list", "bytes"])
def test_a_container_is_refused_and_does_not_become_a_text(annotation: str) -> None:
    def made(sizes) -> None: ...

    made.__annotations__["sizes"] = annotation
    with pytest.raises(ArgumentError, match=r"argument 'sizes' is a .* let the constructor take a str and split it"):
        bind(made, {"sizes": "[1, 2]"})


def test_a_class_without_a_constructor_takes_nothing() -> None:
    class Plain: ...

    assert parameters_of(Plain) == ()
    with pytest.raises(ArgumentError, match="no argument 'steps'; its arguments: none"):
        bind(Plain, {"steps": "1"})

from __future__ import annotations

import inspect
import re
from pathlib import Path

import pytest

from carecontact import errors


def classes() -> dict[str, type[Exception]]:
    return {n: c for n, c in vars(errors).items() if inspect.isclass(c) and issubclass(c, Exception)}


def test_the_tree_in_the_docstring_is_the_tree() -> None:
    """One ``except CarecontactError`` at the command line has to catch them all."""
    drawn: dict[str, str] = {}
    above: list[str] = []
    for line in (errors.__doc__ or "").splitlines()[2:]:
        found = re.match(r"^([│ ]*)(?:[├└]── )?(\w+)", line)
        if not found or not found[2].endswith("Error"):
            continue
        depth = 0 if "──" not in line else len(found[1]) // 4 + 1
        above[depth:] = [found[2]]
        if depth:
            drawn[found[2]] = above[depth - 1]
    assert drawn == {n: c.__bases__[0].__name__ for n, c in classes().items() if n != "CarecontactError"}


def test_unknown_name_lists_the_valid_ones_in_order() -> None:
    error = errors.UnknownNameError("body", "giant", (n for n in ["woman", "man"]))
    assert str(error) == "no body named 'giant'; valid: man, woman"
    assert (error.kind, error.name, error.valid) == ("body", "giant", ["man", "woman"])
    assert "(none)" in str(errors.UnknownNameError("body", "giant", []))


@pytest.mark.parametrize("kind", errors.PolicyError.KINDS)
def test_policy_error_keeps_its_kind(kind: str) -> None:
    error = errors.PolicyError(kind, "it broke")
    assert (error.kind, str(error)) == (kind, "it broke")


def test_policy_error_of_an_unknown_kind_is_a_bug_of_ours() -> None:
    with pytest.raises(ValueError, match="unknown policy failure kind 'tired'; valid: start, argument, "):
        errors.PolicyError("tired", "")


@pytest.mark.parametrize(
    ("name", "meant"),
    [
        ("Hovr", " (did you mean 'hover'?)"),
        ("pose", " (did you mean 'pose_tcp_in_base'?)"),
        ("hz", " (did you mean 'control_hz'?)"),
        ("woman", ""),
        ("h", ""),
        ("nothing", ""),
    ],
)
def test_what_was_meant_is_near_or_the_only_name_that_contains_it(name: str, meant: str) -> None:
    valid = ("hover", "pose_tcp_in_base", "control_hz", "woman-adult-heavy", "woman-adult-light")
    assert errors.did_you_mean(name, valid) == meant


def test_a_count_has_the_right_plural() -> None:
    assert [errors.counted(n, "trial") for n in (0, 1, 2)] == ["0 trials", "1 trial", "2 trials"]
    assert [errors.counted(n, "body is", "bodies are") for n in (1, 2)] == ["1 body is", "2 bodies are"]


def test_no_message_has_a_plural_in_brackets() -> None:
    """``3 trial(s)``; a call such as ``in_region(s)`` has no blank before its name."""
    found = {
        path: re.search(r"\} [a-z ]+\(s\)", path.read_text()) for path in Path(errors.__file__).parent.rglob("*.py")
    }
    assert {path: match for path, match in found.items() if match} == {}

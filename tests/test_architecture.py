"""docs/architecture.md shows the packages and layers that there are."""

from __future__ import annotations

import ast
import re
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "src" / "carecontact"
PAGE = (ROOT / "docs" / "architecture.md").read_text()
PACKAGES = sorted(path.parent.relative_to(PACKAGE).as_posix() for path in PACKAGE.glob("*/**/__init__.py"))


def test_the_page_names_every_package_and_nothing_else() -> None:
    assert re.findall(r"^\| `([a-z_/]+)/` \|", PAGE, re.MULTILINE) == PACKAGES


def test_the_page_shows_the_layers_that_are_checked() -> None:
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]
    checked = next(contract["layers"] for contract in contracts if contract["type"] == "layers")
    block = re.search(r"```layers\n(.*?)```", PAGE, re.DOTALL)
    assert block is not None
    assert block[1].splitlines() == [layer.replace("carecontact.", "") for layer in checked]


def test_the_drawing_names_packages_that_there_are() -> None:
    drawing = PAGE.split("```")[1]
    named = set(re.findall(r"\b([a-z_]+)/", drawing))
    assert named <= set(PACKAGES)
    assert {"protocols", "episode", "policies", "hosting", "recording", "scoring", "reports"} <= named


@pytest.mark.parametrize("package", PACKAGES)
def test_a_package_says_in_one_sentence_what_lives_there(package: str) -> None:
    docstring = ast.get_docstring(ast.parse((PACKAGE / package / "__init__.py").read_text()))
    assert docstring is not None
    assert re.findall(r"[.!?](?=\s|$)", docstring) == ["."], docstring

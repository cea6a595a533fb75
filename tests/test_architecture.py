"""docs/evidence/architecture.md shows the packages and layers that there are."""

from __future__ import annotations

import ast
import pkgutil
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "src" / "carecontact"
PAGE = (ROOT / "docs" / "evidence" / "architecture.md").read_text()
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
    assert {"protocol", "episode", "policies", "serving", "recording", "scoring", "report"} <= named


@pytest.mark.parametrize("package", PACKAGES)
def test_a_package_says_in_one_sentence_what_lives_there(package: str) -> None:
    docstring = ast.get_docstring(ast.parse((PACKAGE / package / "__init__.py").read_text()))
    assert docstring is not None
    assert re.findall(r"[.!?](?=\s|$)", docstring) == ["."], docstring


def test_the_files_of_the_page_exist() -> None:
    table = PAGE.partition("## Where is it?")[2].partition("\n## ")[0]
    named = re.findall(r"`([a-z_]+/[\w/.*]*)`", table)
    assert len(named) > 20
    assert all(any(PACKAGE.glob(name)) for name in named), named


NAMED = re.compile(rf"``((?:{'|'.join(name for name in PACKAGES if '/' not in name)})(?:\.\w+)+)``")


def test_what_docstrings_point_to_exists() -> None:
    missing = list[str]()
    for path in sorted(PACKAGE.rglob("*.py")):
        for name in NAMED.findall(path.read_text()):
            try:
                pkgutil.resolve_name(f"carecontact.{name}")
            except (ImportError, AttributeError):
                if not name.endswith(".json"):
                    missing.append(f"{path.relative_to(PACKAGE)}: {name}")
    assert not missing


# What must not be loaded: the walls that import-linter draws, seen from a running interpreter.

NO_SIMULATOR = ("scoring", "stats", "recording", "interface", "protocol", "policies", "report")
HEAVY = {"numpy", "scipy", "pydantic", "matplotlib", "h5py", "jinja2", "mujoco", "ai_edge_litert", "PIL", "websockets"}


def loaded_after(code: str) -> set[str]:
    done = subprocess.run(
        [sys.executable, "-c", f"{code}\nimport sys\nprint(*sys.modules)"],
        capture_output=True,
        text=True,
        check=True,
    )
    return set(done.stdout.splitlines()[-1].split())


def test_no_module_of_these_packages_loads_the_simulator() -> None:
    loaded = loaded_after(
        "import importlib, pkgutil\n"
        f"for name in {NO_SIMULATOR}:\n"
        "    package = importlib.import_module(f'carecontact.{name}')\n"
        "    for module in pkgutil.walk_packages(package.__path__, package.__name__ + '.'):\n"
        "        if not module.name.endswith('__main__'):\n"
        "            importlib.import_module(module.name)\n"
        "import carecontact.cli.scores, carecontact.cli.publish, carecontact.cli.run, carecontact.cli.compare"
    )
    assert {f"carecontact.{name}" for name in NO_SIMULATOR} <= loaded
    assert not loaded & {"mujoco", "ai_edge_litert", "carecontact.world", "carecontact.sim"}


def test_the_test_sees_a_simulator_that_is_loaded() -> None:
    assert "mujoco" in loaded_after("import mujoco")


def test_the_gate_of_an_action_is_found_without_the_scorer() -> None:
    loaded = loaded_after("from carecontact.protocol.gates import ACTIONS\nACTIONS['touch'].gate_in('exam')")
    ours = sorted(name for name in loaded if name.startswith("carecontact"))
    assert len(ours) <= 10, ours
    assert not loaded & {"carecontact.scoring", "carecontact.recording"}


def test_help_loads_nothing_heavy() -> None:
    loaded = loaded_after(
        "from carecontact.cli import main\ntry:\n    main(['run', '--help'])\nexcept SystemExit:\n    pass"
    )
    assert "carecontact.cli.run" in loaded
    assert not loaded & {"carecontact.cli.serve", "carecontact.cli.compare"}, "only the command that is called"
    assert not loaded & HEAVY


def test_the_list_of_commands_loads_nothing_heavy() -> None:
    loaded = loaded_after("from carecontact.cli import main\ntry:\n    main([])\nexcept SystemExit:\n    pass")
    assert not loaded & (HEAVY | {"carecontact.cli.run"})


def test_scoring_and_reporting_commands_load_no_simulator() -> None:
    loaded = loaded_after(
        "import carecontact.cli.publish, carecontact.scoring, carecontact.report, carecontact.cli.run, "
        "carecontact.cli.compare, carecontact.report.comparison"
    )
    assert not loaded & {"mujoco", "ai_edge_litert"}

"""What must not be loaded: the walls that import-linter draws, seen from a running interpreter."""

from __future__ import annotations

import subprocess
import sys

import pytest

NO_SIMULATOR = ("scoring", "stats", "recording", "contract", "policies", "reports")
HEAVY = {"numpy", "scipy", "pydantic", "matplotlib", "h5py", "jinja2", "mujoco", "mediapipe", "cv2", "websockets"}


def loaded_after(code: str) -> set[str]:
    done = subprocess.run(
        [sys.executable, "-c", f"{code}\nimport sys\nprint(*sys.modules)"],
        capture_output=True,
        text=True,
        check=True,
    )
    return set(done.stdout.splitlines()[-1].split())


@pytest.mark.parametrize("package", NO_SIMULATOR)
def test_no_module_of_the_package_loads_the_simulator(package: str) -> None:
    loaded = loaded_after(
        "import importlib, pkgutil\n"
        f"package = importlib.import_module('carecontact.{package}')\n"
        "for module in pkgutil.walk_packages(package.__path__, package.__name__ + '.'):\n"
        "    if not module.name.endswith('__main__'):\n"
        "        importlib.import_module(module.name)"
    )
    assert f"carecontact.{package}" in loaded
    assert not loaded & {"mujoco", "mediapipe", "carecontact.world", "carecontact.sim"}


def test_the_test_sees_a_simulator_that_is_loaded() -> None:
    assert "mujoco" in loaded_after("import mujoco")


def test_help_loads_nothing_heavy() -> None:
    loaded = loaded_after(
        "from carecontact.cli import main\ntry:\n    main(['run', '--help'])\nexcept SystemExit:\n    pass"
    )
    assert "carecontact.cli.run" in loaded
    assert not loaded & {"carecontact.cli.serve", "carecontact.cli.compare"}, "only the command that is called"
    assert not loaded & HEAVY


def test_the_list_of_commands_loads_nothing_heavy() -> None:
    loaded = loaded_after("from carecontact.cli import main\ntry:\n    main([])\nexcept SystemExit:\n    pass")
    assert {"carecontact.cli.run", "carecontact.cli.serve", "carecontact.cli.compare"} <= loaded
    assert not loaded & HEAVY


def test_scoring_and_reporting_commands_load_no_simulator() -> None:
    loaded = loaded_after(
        "import carecontact.cli.score, carecontact.scoring, carecontact.reports, carecontact.cli.run, "
        "carecontact.cli.compare, carecontact.reports.compare.comparison"
    )
    assert not loaded & {"mujoco", "mediapipe"}

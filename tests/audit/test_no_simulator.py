"""No simulator in the re-deriving process: seen by its interpreter, not asked of its own hook."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import carecontact
from carecontact.audit.no_simulator import CLOSED, within_reach
from carecontact.audit.rederive import BOOTSTRAP

ROOT = str(Path(carecontact.__file__).resolve().parents[1])


def imported_by(code: str, logs: Path) -> set[str]:
    """Modules that the interpreter's own import log names."""
    done = subprocess.run(
        [sys.executable, "-P", "-X", "importtime", "-c", code, ROOT, str(logs)],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    return {line.rpartition("|")[2].strip() for line in done.stderr.splitlines() if line.startswith("import time:")}


def closed(modules: set[str]) -> set[str]:
    return {m for m in modules if any(m == part or m.startswith(f"{part}.") for part in CLOSED)}


def test_nothing_closed_was_imported(tmp_path: Path) -> None:
    modules = imported_by(BOOTSTRAP, tmp_path)
    assert "carecontact.audit.rederive" in modules
    assert closed(modules) == set()


def test_without_the_hook_a_simulator_would_be_seen(tmp_path: Path) -> None:
    reaching = "import sys; sys.path.insert(0, sys.argv[1]); import carecontact.world, mujoco"
    assert {"mujoco", "carecontact.world"} <= closed(imported_by(reaching, tmp_path))
    # Here, where nothing is refused.
    assert set(CLOSED) <= set(within_reach())


def test_the_hook_refuses_what_is_installed(tmp_path: Path) -> None:
    trying = (
        "import sys; sys.path.insert(0, sys.argv[1])\n"
        "from carecontact.audit.no_simulator import CLOSED, refuse_simulators\n"
        "refuse_simulators()\n"
        "for name in CLOSED:\n"
        "    try:\n"
        "        __import__(name)\n"
        "    except ImportError:\n"
        "        continue\n"
        "    raise SystemExit(f'{name} was imported')\n"
    )
    # The log names what was tried and refused too; nothing of their insides ran.
    assert closed(imported_by(trying, tmp_path)) - set(CLOSED) == set()

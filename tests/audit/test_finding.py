from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import carecontact
from carecontact.audit import finding
from carecontact.audit.finding import CLOSED, within_reach
from carecontact.audit.raw_log import differences
from carecontact.audit.rederive import REDERIVE_BOOTSTRAP
from carecontact.audit.watched import Keyframe
from carecontact.errors import CarecontactError
from carecontact.policies.motion import CONTROL_HZ
from carecontact.protocol.load import load_protocol
from carecontact.protocol.protocol import TrialSpec

SAYS = (
    "import json, os, sys; print('a line'); print(json.dumps({'got': sys.argv[2], 'gl': os.environ.get('MUJOCO_GL')}))"
)


def test_the_last_line_is_what_it_says(tmp_path: Path) -> None:
    answer = finding.output_of(SAYS, tmp_path, environment={"MUJOCO_GL": "egl"})
    assert answer == {"got": str(tmp_path), "gl": "egl"}


def test_what_breaks_or_hangs_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(CarecontactError, match="ended with status 1: no such luck"):
        finding.output_of("raise SystemExit('no such luck')", tmp_path)
    monkeypatch.setattr(finding, "LONGEST_S", 0.2)
    with pytest.raises(CarecontactError, match=r"did not end within 0\.2 s"):
        finding.output_of("import time; time.sleep(60)", tmp_path)


# No simulator in the re-deriving process: seen by its interpreter, not asked of its own hook.

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
    modules = imported_by(REDERIVE_BOOTSTRAP, tmp_path)
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
        "from carecontact.audit.finding import CLOSED, refuse_simulators\n"
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


NAN = np.array([1.0, np.nan], np.float32)


@pytest.mark.parametrize("value", [{"a": [1, "b", None, True]}, NAN, {"x": NAN, "y": float("nan")}, np.zeros((0, 3))])
def test_equal_to_the_last_bit(value: object) -> None:
    assert differences(value, value, "m") == []


@pytest.mark.parametrize(
    ("expected", "got", "place", "text"),
    [
        ({"a": 1}, {"a": 1, "seed": 3}, "m.seed", "is present"),
        ({"a": 1, "b": 2}, {"a": 1}, "m.b", "is missing"),
        ({"a": [1, 2]}, {"a": [1, 3]}, "m.a[1]", "expected 2, got 3"),
        ([1], [1, 2], "m", "expected [1], got [1, 2]"),
        (1, True, "m", "expected 1, got True"),
        (1.0, 1.0 + 1e-15, "m", "expected 1.0"),
        (np.zeros(3), np.array([0.0, -0.0, 1e-300]), "m", "2 of 3 numbers differ, by up to 1e-300"),
        (np.zeros(3), np.zeros(3, np.float32), "m", "expected float64 (3,), got float32 (3,)"),
        (np.zeros((2, 2), bool), np.ones((2, 2), bool), "m", "4 of 4 numbers differ, by up to 1"),
        (NAN, np.array([1.0, 2.0], np.float32), "m", "1 of 2 numbers differ"),
    ],
)
def test_a_difference_is_named(expected: object, got: object, place: str, text: str) -> None:
    ((where, what),) = differences(expected, got, "m")
    assert where == place
    assert what.startswith(text)


@pytest.mark.slow
def test_the_press_meets_soft_tissue_beside_a_large_chest() -> None:
    """A hand that lands on the chest first is stopped by bone, whose force tells nothing about tissue; seed 0 is a
    heavy woman."""
    protocol = load_protocol("bathing-wide-v2", level="L3")
    spec = TrialSpec(protocol=protocol, task_id="T4", seed=0, policy="hover")
    keyframe = Keyframe(protocol, task_id="T4", seed=0)
    simulation, _, _ = keyframe.near(spec)
    steps = round(1 / CONTROL_HZ / simulation.model.opt.timestep)
    for pose in keyframe.poses:
        simulation.set_goal(pose, 1 / CONTROL_HZ)
        simulation.advance(steps)
    assert simulation.tissue["upper_arm"].last(simulation.data, steps)["force_n"].any()

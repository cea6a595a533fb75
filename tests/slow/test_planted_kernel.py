"""Defects are planted in the C sources of the tissue, and a named check finds each of them.

Every other planted defect changes the numbers that the compiled tissue computes with; these are wrong formulas, which
no number can plant. Each mutant is compiled into a copy of the kernel's folder and loaded in a process of its own.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import mujoco
import pytest

from carecontact.tissue import binary
from tools import compile_kernel

pytestmark = pytest.mark.slow
ROOT = Path(__file__).parents[2]
COMPILER = next(filter(None, map(shutil.which, ("gcc", "clang"))), None)
FLAGS = ("-std=c17", "-O2", "-fPIC", "-fvisibility=hidden", "-ffp-contract=off")
MUTANTS = {
    "half of the damping": (
        "region.h", "{ return law->damping +", "{ return 0.5 * law->damping +",
        "declared", "displaced skin returns",
    ),
    "a tenth of the inertia": (
        "solve.c", "v->area * law->mass / (dt * dt)", "0.1 * v->area * law->mass / (dt * dt)",
        "declared", "a kick of the skin dies",
    ),
    "wrong sign on the bone": (
        "wrench.c", "  apply(m, d, r, r->bone, total, total + 3);",
        "  for (int j = 0; j < 6; j++) total[j] *= -1;\n  apply(m, d, r, r->bone, total, total + 3);\n"
        "  for (int j = 0; j < 6; j++) total[j] *= -1;",
        "force-balance", "bed",
    ),
}  # fmt: skip
MUTANTS_OF_THE_CONTACT = {
    "no brake of the tool that lets skin in": (
        "wrench.c", "if (lets_in) f[j] += area * c->pressure * c->drag[j];", "(void)lets_in;",
        "abdomen", "most energy made",
    ),
    "energy of a linear layer": (
        "layer.h", "return k * d * d * (0.5 + x * x / 4);", "return (void)x, k * d * d / 2;",
        "upper_arm", "not accounted for",
    ),
}  # fmt: skip
"""The ledger of ``energy`` finds them."""
OLD_BRAKE = (
    "entry.c",
    "c->drag[k] = falls * c->bristle[k] / BRISTLE;",
    "c->drag[k] = dot(way, way) > 1e-18 ? falls * way[k] / sqrt(dot(way, way)) : 0;",
)
"""Full against every step's way, also where the tool stands: it turns round in every step there."""
CODE = """
import sys
from pathlib import Path
from carecontact.tissue import binary
binary.FOLDER = Path(sys.argv[1])
binary.SOURCES = binary.FOLDER / "c"
from carecontact.protocol.load import load_protocol
from carecontact.lab.validation import energy as ledger, smoothness
from carecontact.lab.validation.passive_response import lock_arm
from carecontact.lab.validation.run import validate
from carecontact.lab.validation.subject import Subject
protocol, check = load_protocol("bathing-v3"), sys.argv[2]
if check == "turning":
    simulation = Subject(protocol).hovering("abdomen")
    lock_arm(simulation)
    done = smoothness.scrub(simulation, 15.0, strokes=2, region="abdomen")
    measures = done.measures("abdomen", wanted=15.0, friction=protocol.person.tissue["abdomen"].friction)
    print(*(m.name for m in measures if m.met is False), sep="\\n")
elif check in protocol.regions:
    measures = ledger.ledger_measures(Subject(protocol), check, quick=False)
    print(*(m.name for m in measures if m.decides and m.met is False), sep="\\n")
else:
    for result in validate(protocol, quick=True, checks=[check]).results:
        print(result.error or "", *(m.name for m in result.missed), sep="\\n")
"""


def found_by(folder: Path, check: str) -> list[str]:
    """What a check misses, or why it could not be finished, with the binary in a folder. A region in place of a check
    stands for the ledger of ``energy`` there, in its full form, and "turning" for a scrub of the abdomen with 15 N."""
    done = subprocess.run(
        [sys.executable, "-c", CODE, str(folder), check], capture_output=True, text=True, check=True, cwd=ROOT
    )
    return [line for line in done.stdout.splitlines() if line]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """The kernel's folder, copied. Skips where this machine has no compiler."""
    if COMPILER is None or sys.platform != "linux":
        pytest.skip("needs gcc or clang on Linux")
    return Path(shutil.copytree(binary.FOLDER, tmp_path / "kernel", ignore=shutil.ignore_patterns("__pycache__")))


def compiled(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compile_kernel.binary, "SOURCES", folder / "c")
    here, mujocos = binary.platform_here(), Path(mujoco.__file__).parent
    assert COMPILER is not None
    subprocess.run(
        [
            COMPILER,
            *compile_kernel.arguments(compile_kernel.mujoco_headers(), here, FLAGS),
            str(mujocos / f"libmujoco.so.{binary.MUJOCO}"),
            f"-Wl,-rpath,{mujocos}",
            "-lm",
            "-o",
            str(folder / binary.PLATFORMS[here].library),
        ],
        check=True,
    )


def planted(source: Path, right: str, wrong: str) -> None:
    assert source.read_text().count(right) == 1
    source.write_text(source.read_text().replace(right, wrong))


@pytest.mark.parametrize("name", MUTANTS)
def test_a_wrong_formula_is_found_by_name(name: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file, right, wrong, check, message = MUTANTS[name]
    planted(folder / "c" / file, right, wrong)
    compiled(folder, monkeypatch)
    assert any(message in line for line in found_by(folder, check))


@pytest.mark.parametrize("name", MUTANTS_OF_THE_CONTACT)
def test_a_wrong_formula_of_the_contact_is_found_in_the_ledger(
    name: str, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file, right, wrong, region, message = MUTANTS_OF_THE_CONTACT[name]
    planted(folder / "c" / file, right, wrong)
    compiled(folder, monkeypatch)
    assert any(message in line for line in found_by(folder, region))


def test_a_brake_that_does_not_hold_is_found_where_the_tool_turns_round(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file, right, wrong = OLD_BRAKE
    planted(folder / "c" / file, right, wrong)
    compiled(folder, monkeypatch)
    assert found_by(folder, "turning") == [
        "abdomen: force noise where it turns round above 20 Hz, rms",
        "abdomen: force noise along the skin where it turns round above 20 Hz, rms",
    ]


@pytest.mark.parametrize("check", ["declared", "force-balance", "abdomen", "upper_arm", "turning"])
def test_the_right_formulas_compiled_alike_are_not_blamed(
    check: str, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    compiled(folder, monkeypatch)
    assert found_by(folder, check) == []

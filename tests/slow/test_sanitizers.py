"""The C of the tissue under the address and undefined-behaviour sanitizers of this machine's C compiler.

The tests of KERNEL_TESTS run once more in a process whose library is compiled with both. ziglang has no run-time
library for the first, so that this needs gcc or clang.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest
from tools.compile_kernel import arguments, mujoco_headers

import carecontact
from carecontact.tissue import binary, plugin
from tests.tissue.sheets import Array, corners_of_a_box, model_xml, sheet, tissue

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
KERNEL_TESTS = ("tests/tissue",)
"""What exercises the C."""
SANITIZED = (
    "-std=c17",
    "-O1",
    "-g",
    "-fPIC",
    "-fvisibility=hidden",
    "-ffp-contract=off",
    "-fno-omit-frame-pointer",
    "-fsanitize=address,undefined",
    "-fno-sanitize-recover=all",
)
OPTIONS = {"UBSAN_OPTIONS": "print_stacktrace=1"}
NO_LEAKS = {**OPTIONS, "ASAN_OPTIONS": "detect_leaks=0"}
"""Python does not free all that it allocates; steps_a_model.c looks for leaks without it."""
COMPILER = next(filter(None, map(shutil.which, ("gcc", "clang"))), None)


def sanitized(*command: str) -> None:
    assert COMPILER is not None
    subprocess.run([COMPILER, *command], check=True, cwd=ROOT)


def to_link() -> list[str]:
    """MuJoCo's own library, which is loaded already or found where its wheel put it."""
    folder = Path(mujoco.__file__).parent
    return [str(folder / f"libmujoco.so.{binary.MUJOCO}"), f"-Wl,-rpath,{folder}", "-lm"]


@pytest.fixture(scope="module")
def runtime() -> str:
    """The sanitizer's library, which must be loaded before Python. Skips where this machine has none."""
    if sys.platform != "linux":
        pytest.skip("the sanitizers are set up for Linux")
    if COMPILER is None:
        pytest.skip("neither gcc nor clang is installed")
    name = "libasan.so" if COMPILER.endswith("gcc") else "libclang_rt.asan-x86_64.so"
    path = subprocess.run(
        [COMPILER, f"-print-file-name={name}"], capture_output=True, text=True, check=True
    ).stdout.strip()
    if not Path(path).is_absolute():
        pytest.skip(f"{COMPILER} is installed without {name}")
    return path


@pytest.fixture(scope="module")
def package(runtime: str, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder to import carecontact from, whose library is a sanitized one; all else is linked from the sources."""
    folder = tmp_path_factory.mktemp("sanitized")
    source = Path(carecontact.__file__).parent
    shutil.copytree(
        source, folder / "carecontact", copy_function=os.symlink, ignore=shutil.ignore_patterns("__pycache__")
    )
    name = binary.platform_here()
    made = folder / "carecontact" / "tissue" / binary.PLATFORMS[name].library
    made.unlink(missing_ok=True)
    sanitized(*arguments(mujoco_headers(), name, SANITIZED), *to_link(), "-o", str(made))
    return folder


def under_sanitizers(
    *command: str, runtime: str, package: Path | None = None, check: bool = True
) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, **NO_LEAKS, "LD_PRELOAD": runtime}
    if package is not None:
        environment["PYTHONPATH"] = str(package)
    done = subprocess.run(
        [sys.executable, *command], env=environment, capture_output=True, text=True, check=False, cwd=ROOT
    )
    assert not check or done.returncode == 0, f"{done.stdout[-4000:]}\n{done.stderr[-8000:]}"
    return done


def test_the_tests_of_the_kernel_pass(runtime: str, package: Path) -> None:
    where = "from carecontact.tissue import binary_lookup as b, plugin; plugin.load_plugins(); print(b.binary_file())"
    loaded = under_sanitizers("-c", where, runtime=runtime, package=package)
    assert loaded.stdout.startswith(str(package)), "the sanitized library is the one that is tested"
    done = under_sanitizers(
        "-m", "pytest", "-q", "-p", "no:cacheprovider", "-n", "0", *KERNEL_TESTS, runtime=runtime, package=package
    )
    assert "[100%]" in done.stdout


THIN = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0], [0, 0, 1e-5], [0, 0, -1e-5]]) * 0.01
"""A hull so thin that all of its faces count as two, which no tissue can touch."""


@pytest.mark.parametrize(
    ("vertices", "message"),
    [(None, "1 plugin instances"), (corners_of_a_box(0.02, 0.02, 0.02), "1 plugin instances"), (THIN, "init failed")],
    ids=["ball", "hull", "thin hull"],
)
def test_the_plugin_frees_what_it_allocates(vertices: Array | None, message: str, runtime: str, tmp_path: Path) -> None:
    model = tmp_path / "model.xml"  # an mjb file names a plugin by the order in which a process registered it
    plugin.load_plugins()
    model.write_text(model_xml(tissue(), sheet(half_m=0.02), vertices=vertices))
    program = tmp_path / "steps_a_model"
    parts = [part for part in arguments(mujoco_headers(), binary.platform_here(), SANITIZED) if part != "-shared"]
    sanitized(*parts, "tests/slow/steps_a_model.c", *to_link(), "-o", str(program))
    done = subprocess.run(
        [str(program), str(model), "200"], env={**os.environ, **OPTIONS}, capture_output=True, text=True, check=False
    )
    assert "Sanitizer" not in done.stderr, done.stderr
    assert message in done.stdout + done.stderr


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        ("char* p = calloc(index, 1); free(p); return *p;", "heap-use-after-free"),
        ("return 2147483640 + index;", "signed integer overflow"),
    ],
)
def test_a_planted_fault_is_seen(fault: str, message: str, runtime: str, tmp_path: Path) -> None:
    source, made = tmp_path / "planted.c", tmp_path / "planted.so"
    source.write_text(
        f'#include <stdlib.h>\n__attribute__((visibility("default"))) int planted(int index) {{ {fault} }}\n'
    )
    sanitized(*SANITIZED, "-shared", str(source), "-o", str(made))
    call = f"import ctypes; ctypes.CDLL({str(made)!r}).planted(8)"
    done = under_sanitizers("-c", call, runtime=runtime, check=False)
    assert done.returncode != 0
    assert message in done.stderr

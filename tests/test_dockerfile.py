"""The image is made by the same tools, of the same packages, as the environment of a clone. No image is built here."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

from carecontact.sim.opengl import PACKAGES

ROOT = Path(__file__).parents[1]
TEXT = (ROOT / "Dockerfile").read_text()


def test_it_uses_the_uv_of_the_bootstrap() -> None:
    version = re.search(r"^UV_VERSION=(\S+)", (ROOT / "tools/bootstrap.sh").read_text(), re.MULTILINE)
    assert version
    assert f"uv=={version[1]}" in TEXT


def test_it_installs_what_rendering_needs() -> None:
    assert all(package in TEXT for package in PACKAGES["egl"].split())


def test_the_build_context_has_what_the_build_reads() -> None:
    kept = [line[1:] for line in (ROOT / ".dockerignore").read_text().splitlines() if line.startswith("!")]
    assert all((ROOT / path).exists() for path in kept)
    assert {"src", "hatch_build.py", "tools/compile_kernel.py", "uv.lock", "pyproject.toml"} <= set(kept)


def test_hadolint_finds_nothing() -> None:
    hadolint = shutil.which("hadolint", path=str(Path(sys.executable).parent))
    assert hadolint, "hadolint is in the group dev: run make env"
    found = subprocess.run([hadolint, str(ROOT / "Dockerfile")], capture_output=True, text=True)
    assert found.returncode == 0, found.stdout

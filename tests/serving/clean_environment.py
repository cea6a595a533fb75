"""A Python that has numpy, msgpack and websockets, and nothing else that is installed here."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path

PACKAGES = ("numpy", "msgpack", "websockets")
START = """
import runpy, sys
sys.path[:0] = sys.argv[1:3]
for absent in ("carecontact", "mujoco", "scipy"):
    try:
        __import__(absent)
    except ImportError:
        continue
    raise SystemExit(f"{absent} can be imported")
sys.argv[:] = sys.argv[3:]
runpy.run_path(sys.argv[0], run_name="__main__")
"""


def site_with(folder: Path) -> Path:
    """A folder that holds PACKAGES alone, with numpy's libraries."""
    site = folder / "site"
    site.mkdir()
    for name in PACKAGES:
        spec = find_spec(name)
        assert spec is not None
        assert spec.origin is not None
        package = Path(spec.origin).parent
        for found in (package, package.with_name(f"{name}.libs")):
            if found.is_dir():
                (site / found.name).symlink_to(found)
    return site


@contextmanager
def running(script: Path, *arguments: str, site: Path, modules: Path) -> Iterator[subprocess.Popen[str]]:
    """The script in such a Python, killed at the end. ``modules``: one more folder to import from."""
    command = [sys.executable, "-I", "-S", "-u", "-c", START, str(site), str(modules), str(script), *arguments]
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env={"PATH": os.environ.get("PATH", "")}
    )
    try:
        yield process
    finally:
        process.kill()
        process.communicate()

"""Finds and checks the binary that this machine would load, and says which kernel it is. It loads neither the binary
nor MuJoCo.
"""

from __future__ import annotations

import hashlib
import sys
from importlib import metadata
from pathlib import Path

from carecontact.errors import DependencyError
from carecontact.tissue import binary


def binary_sha256() -> str:
    """Return the sha256 (hex) of the binary, on which every result depends besides MuJoCo's version.

    Raises DependencyError as ``file`` does.
    """
    return hashlib.sha256(binary_file().read_bytes()).hexdigest()


def binary_file() -> Path:
    """Return the path of the binary. Raises DependencyError if ``problem`` finds one."""
    if found := binary_problem():
        what, command = found
        raise DependencyError(f"the compiled tissue {what}" + (f"; run `{command}`" if command else ""))
    return binary.library_file(binary.platform_here())


def binary_problem() -> tuple[str, str | None] | None:
    """Return why this machine cannot load the binary, or None if it can.

    The reason is the end of a sentence about the binary: it does not exist for the platform, it is missing, it does not
    belong to the C sources beside it, or MuJoCo has another version. The second item is the command that helps, or None
    if no command does.
    """
    name = binary.platform_here()
    if fault := binary.fault(name):
        return fault, build_command() if name in binary.PLATFORMS else None
    try:
        version = metadata.version("mujoco")
    except metadata.PackageNotFoundError:
        version = "not installed"
    if version != binary.MUJOCO:
        pip = f"{sys.executable} -m pip install mujoco=={binary.MUJOCO}"
        return f"needs MuJoCo {binary.MUJOCO}, and it is {version}", pip
    return None


def build_command(*, afresh: bool = False) -> str:
    """Return the command that makes or installs the right binary.

    Args:
        afresh: whether the command shall replace a binary that has the right mark but does not load.
    """
    clone = binary.FOLDER.parents[2]
    if (clone / "tools" / "bootstrap.sh").is_file():
        make = f"make -C {clone} env"
        return f"rm {binary.library_file(binary.platform_here())} && {make}" if afresh else make
    return f"{sys.executable} -m pip install --force-reinstall --no-deps CARECONTACT.whl"

"""Finds and checks the binary that this machine would load, without loading it or MuJoCo."""

from __future__ import annotations

import hashlib
import sys
from importlib import metadata
from pathlib import Path

from carecontact.errors import DependencyError
from carecontact.tissue import binary


def binary_sha256() -> str:
    """Return the sha256 (hex) of the binary, on which every result depends besides MuJoCo's version.

    Raises DependencyError as ``binary_file`` does.
    """
    return hashlib.sha256(binary_file().read_bytes()).hexdigest()


def binary_file() -> Path:
    """Return the path of the binary. Raises DependencyError if it has a problem (``binary_problem``)."""
    if found := binary_problem():
        what, command = found
        raise DependencyError(f"the compiled tissue {what}" + (f"; run `{command}`" if command else ""))
    return binary.library_file(binary.platform_here())


def binary_problem() -> tuple[str, str | None] | None:
    """Return why this machine cannot load the binary, as the end of a sentence about it, and the command that helps or
    None if no command does; None if the machine can load it.
    """
    name = binary.platform_here()
    if fault := binary.fault(name):
        return fault, build_command() if name in binary.PLATFORMS else None
    try:
        version = metadata.version("mujoco")
    except metadata.PackageNotFoundError:
        version = "not installed"
    if version == binary.MUJOCO:
        return None
    pip = f"{sys.executable} -m pip install mujoco=={binary.MUJOCO}"
    return f"needs MuJoCo {binary.MUJOCO}, and it is {version}", pip


def build_command(*, afresh: bool = False) -> str:
    """Return the command that makes or installs the right binary.

    ``afresh``: whether it replaces a binary that has the right mark but does not load.
    """
    clone = binary.FOLDER.parents[2]
    if not (clone / "tools" / "bootstrap.sh").is_file():
        return f"{sys.executable} -m pip install --force-reinstall --no-deps CARECONTACT.whl"
    make = f"make -C {clone} env"
    return f"rm {binary.library_file(binary.platform_here())} && {make}" if afresh else make

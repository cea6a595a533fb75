"""The binary that this machine would load, checked, and its hash; loads neither it nor MuJoCo."""

from __future__ import annotations

import hashlib
import sys
from importlib import metadata
from pathlib import Path

from carecontact.errors import DependencyError
from carecontact.kernel import binary


def sha256() -> str:
    """Of the binary: what a result depends on besides MuJoCo's version. Raises DependencyError as ``file`` does."""
    return hashlib.sha256(file().read_bytes()).hexdigest()


def file() -> Path:
    """Path of the binary. Raises DependencyError where ``problem`` finds one."""
    if found := problem():
        what, command = found
        raise DependencyError(f"the compiled tissue {what}" + (f"; run `{command}`" if command else ""))
    return binary.library_file(binary.platform_here())


def problem() -> tuple[str, str | None] | None:
    """Why this machine cannot load the binary, as the end of a sentence about it, and the command that helps, if any
    does: there is none for the platform, it is missing, it does not belong to the C sources beside it, or MuJoCo has
    another version. None where nothing is wrong."""
    name = binary.platform_here()
    if fault := binary.fault(name):
        return fault, making() if name in binary.PLATFORMS else None
    try:
        version = metadata.version("mujoco")
    except metadata.PackageNotFoundError:
        version = "not installed"
    if version != binary.MUJOCO:
        pip = f"{sys.executable} -m pip install mujoco=={binary.MUJOCO}"
        return f"needs MuJoCo {binary.MUJOCO}, and it is {version}", pip
    return None


def making(*, afresh: bool = False) -> str:
    """The command that makes or installs the right binary; ``afresh``: also where the one that is there has the right
    mark, but does not load."""
    clone = binary.FOLDER.parents[2]
    if (clone / "tools" / "bootstrap.sh").is_file():
        make = f"make -C {clone} env"
        return f"rm {binary.library_file(binary.platform_here())} && {make}" if afresh else make
    return f"{sys.executable} -m pip install --force-reinstall --no-deps CARECONTACT.whl"

"""Loads the compiled tissue into this process, once, and only where it is the one that belongs here."""

from __future__ import annotations

import ctypes
import functools
import hashlib
import threading
from pathlib import Path

import mujoco

from carecontact.errors import DependencyError
from carecontact.kernel import binary

PLUGIN = "carecontact.tissue"
"""Name of the plugin in a MuJoCo model."""

_loading = threading.Lock()


def load() -> ctypes.CDLL:
    """Register the plugin with MuJoCo, so that models that name it can be compiled, and return the library's functions.

    Later calls return the same object. Raises DependencyError where the binary is missing, does not belong to the C
    sources beside it or does not load, where MuJoCo has another version than the one that the binary was made for, and
    where another library has registered a plugin of this name.
    """
    with _loading:
        return _load()


def sha256() -> str:
    """Of the binary: what a result depends on besides MuJoCo's version. Raises DependencyError as ``load`` does, but
    does not load anything."""
    return hashlib.sha256(right_file().read_bytes()).hexdigest()


def right_file() -> Path:
    """The binary of this machine. Raises DependencyError where it is not the right one, with the command that makes
    it."""
    name = binary.platform_here()
    if problem := binary.fault(name):
        remedy = f"; {remedy_here()}" if name in binary.PLATFORMS else ""
        raise DependencyError(f"the compiled tissue {problem}{remedy}")
    if mujoco.__version__ != binary.MUJOCO:
        raise DependencyError(
            f"the compiled tissue needs MuJoCo {binary.MUJOCO}; this is {mujoco.__version__}; "
            f"run `python -m pip install mujoco=={binary.MUJOCO}`"
        )
    return binary.library_file(name)


def remedy_here() -> str:
    """What to do where the binary is not the right one."""
    clone = binary.FOLDER.parents[2]
    if (clone / "tools" / "bootstrap.sh").is_file():
        return f"run `make env` in {clone}"
    return "run `python -m pip install --force-reinstall --no-deps` with the wheel of carecontact for this platform"


@functools.cache
def _load() -> ctypes.CDLL:
    file = right_file()
    try:
        mujoco.mj_loadPluginLibrary(str(file))
        library = ctypes.CDLL(str(file))
    except (mujoco.FatalError, OSError) as error:
        raise DependencyError(f"the compiled tissue does not load: {' '.join(str(error).split())}") from None
    library.carecontact_kernel_version.restype = ctypes.c_char_p
    if not library.carecontact_kernel_registered():
        raise DependencyError(
            f"another library has registered a MuJoCo plugin named {PLUGIN} in this process; start Python again and "
            f"load only {file}"
        )
    return library

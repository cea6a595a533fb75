"""Loads the compiled tissue into this process, once, and only where it is the one that belongs here."""

from __future__ import annotations

import ctypes
import functools
import threading

import mujoco

from carecontact.errors import DependencyError
from carecontact.kernel import found

PLUGIN = "carecontact.tissue"
"""Name of the plugin in a MuJoCo model."""

_loading = threading.Lock()


def load() -> ctypes.CDLL:
    """Register the plugin with MuJoCo, so that models that name it can be compiled, and return the library's functions.

    Later calls return the same object. Raises DependencyError as ``found.file`` does, where the binary does not load,
    and where another library has registered a plugin of this name.
    """
    with _loading:
        return _load()


@functools.cache
def _load() -> ctypes.CDLL:
    file = str(found.file())
    try:
        mujoco.mj_loadPluginLibrary(file)
        library = ctypes.CDLL(file)
    except (mujoco.FatalError, OSError) as error:
        raise DependencyError(f"the compiled tissue does not load: {' '.join(str(error).split())}") from None
    library.carecontact_kernel_version.restype = ctypes.c_char_p
    if not library.carecontact_kernel_registered():
        raise DependencyError(
            f"another library has registered a MuJoCo plugin named {PLUGIN} in this process; start Python again and "
            f"load only {file}"
        )
    return library

"""Loads the compiled tissue into this process once, after checking that it is the right binary."""

from __future__ import annotations

import ctypes
import functools
import threading

import mujoco

from carecontact.errors import DependencyError
from carecontact.kernel import found

PLUGIN = "carecontact.tissue"
"""Name of the tissue's plugin in a MuJoCo model."""
LIFE_PLUGIN = "carecontact.life"
"""Name of the plugin that moves a person who breathes or moves the arm."""

_loading = threading.Lock()


def load() -> ctypes.CDLL:
    """Register the plugins with MuJoCo, so that models that name them can be compiled, and return the library.

    Later calls return the same object.

    Raises DependencyError as ``found.file`` does, if the binary does not load, and if another library has registered a
    plugin with one of these names.
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
            f"another library has registered a MuJoCo plugin named {PLUGIN} or {LIFE_PLUGIN} in this process; start "
            f"Python again and load only {file}"
        )
    return library

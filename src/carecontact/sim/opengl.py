"""OpenGL without a display: which library renders, and whether it can here. Nothing of MuJoCo is imported before a
context is made, because MuJoCo itself refuses a wrong MUJOCO_GL."""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from ctypes.util import find_library
from functools import cache
from importlib.util import find_spec
from types import ModuleType
from typing import Any

from carecontact.errors import DependencyError
from carecontact.system import is_exhausted

LIBRARIES = {"egl": ("EGL", "GL"), "osmesa": ("OSMesa",)}
"""Backend -> the libraries that it needs."""
PACKAGES = {"egl": "libegl1 libgl1 libgl1-mesa-dri", "osmesa": "libosmesa6"}
"""Backend -> the packages of Debian and Ubuntu that install them."""
INSTALLING = "; install it with: "
"""Part of a message before the command that installs what is missing."""
OTHERS = ("", *"glfw glx cgl wgl enable enabled on true 1 disable disabled off false 0".split())
"""Values of MUJOCO_GL that MuJoCo knows too. They concern windows, so that the choice of a backend is free."""
DECISIVE = (
    *"MUJOCO_EGL_DEVICE_ID CUDA_VISIBLE_DEVICES EGL_PLATFORM __EGL_VENDOR_LIBRARY_FILENAMES".split(),
    *"__EGL_VENDOR_LIBRARY_DIRS LIBGL_DRIVERS_PATH MESA_LOADER_DRIVER_OVERRIDE GALLIUM_DRIVER".split(),
)
"""Variables on which a driver or a device depends, and which a message therefore names."""


@cache
def loads(library: str) -> bool:
    """Return whether a library is installed under any version and loads."""
    name = find_library(library)
    try:
        return name is not None and ctypes.CDLL(name) is not None
    except OSError:
        return False


def choose_backend() -> str:
    """Return the backend to use: ``MUJOCO_GL`` if it names one, else egl if its libraries load, else osmesa.

    Raises DependencyError that names the wrong variable, or the packages to install.
    """
    wanted = os.environ.get("MUJOCO_GL", "").strip().lower()
    if wanted not in (*LIBRARIES, *OTHERS):
        raise DependencyError(
            f"MUJOCO_GL={wanted}: no such OpenGL backend; set it to {' or '.join(LIBRARIES)}, or unset it"
        )
    candidates = [wanted] if wanted in LIBRARIES else list(LIBRARIES)
    lacking = {backend: [f"lib{name}" for name in LIBRARIES[backend] if not loads(name)] for backend in candidates}
    backend = next((name for name in candidates if not lacking[name]), candidates[0])
    if lacking[backend]:
        sudo = "" if os.geteuid() == 0 else "sudo "
        chosen = f" (chosen by MUJOCO_GL={wanted})" if wanted == backend else ""
        raise DependencyError(
            f"cannot render with {backend}{chosen}: {' and '.join(lacking[backend])} missing{INSTALLING}"
            f"{sudo}apt-get install -y {PACKAGES[backend]}"
        )
    platform = os.environ.get("PYOPENGL_PLATFORM", "")
    if platform.lower() not in ("", backend):
        raise DependencyError(
            f"PYOPENGL_PLATFORM={platform}: carecontact renders with {backend}; unset this variable, or set it to "
            f"{backend}"
        )
    return backend


def import_opengl() -> Any:
    """Return the class of contexts of the backend to use. Nothing is drawn, and no thread starts, before there is a
    context.

    Raises DependencyError as ``choose_backend`` does, and where the backend cannot be imported; other errors where
    memory or threads are used up, which is no fault of the machine's OpenGL.
    """
    backend = choose_backend()
    # MuJoCo's C library reads this again when it looks up OpenGL functions.
    os.environ["MUJOCO_GL"] = backend
    os.environ.setdefault("PYOPENGL_PLATFORM", backend)
    with _refusals():
        if backend == "egl":
            from mujoco.egl import GLContext
        else:
            from mujoco.osmesa import GLContext
    return GLContext


def make_context(width: int, height: int) -> Any:
    """Return a context that is current in this thread, for pictures of this size [px] at most.

    Raises as ``import_opengl`` does, and DependencyError where there is no device or driver.
    """
    kind = import_opengl()
    with _refusals():
        context = kind(width, height)
        context.make_current()
    return context


@contextmanager
def _refusals() -> Iterator[None]:
    """Raise DependencyError for any error of the body, except where memory or threads are used up."""
    try:
        yield
    except Exception as error:  # ImportError, RuntimeError, AttributeError, TypeError, ValueError, GLError ...
        if is_exhausted(error):
            raise
        raise cannot_render(error) from error


def drawn_by() -> str:
    """Return vendor, renderer and version of the current context, as OpenGL names them."""
    library = ctypes.CDLL(find_library("OSMesa" if os.environ["MUJOCO_GL"] == "osmesa" else "GL"))
    library.glGetString.restype = ctypes.c_char_p
    names = [library.glGetString(name) for name in (0x1F00, 0x1F01, 0x1F02)]  # GL_VENDOR, GL_RENDERER, GL_VERSION
    return ", ".join(text.decode(errors="replace") if text else "unnamed" for text in names)


def cannot_render(error: Exception) -> DependencyError:
    """Return the error to raise where a driver or a device refuses: it names the variables on which that depends."""
    backend = choose_backend()
    why = " ".join(str(error).split()).rstrip(".") or type(error).__name__
    remedy = f"if a driver is missing, install it with: apt-get install -y {PACKAGES[backend]}"
    if given := [f"{name}={os.environ[name]}" for name in DECISIVE if os.environ.get(name)]:
        remedy = f"correct or unset what decides this in the environment: {', '.join(given)}"
    return DependencyError(f"cannot render with {backend}: {why}; {remedy}")


def probe() -> None:
    """Make a context as a trial does and end this process with status 0. Raises as ``make_context`` does.

    MuJoCo's package is replaced by an empty one: its modules for contexts need nothing of it, and importing it takes
    longer than all the rest.
    """
    spec = find_spec("mujoco")
    if spec is not None:
        sys.modules["mujoco"] = stand_in = ModuleType("mujoco")
        stand_in.__path__ = list(spec.submodule_search_locations or ())
    make_context(64, 64)
    # Without the drivers' own clean-up, which takes time and crashes some of them.
    os._exit(0)

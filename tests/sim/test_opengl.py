"""The choice of an OpenGL library, and the messages where none renders; the machine's own libraries do not matter."""

from __future__ import annotations

import pytest

from carecontact.errors import DependencyError
from carecontact.sim import opengl
from carecontact.sim.opengl import cannot_render, choose_backend, make_context


@pytest.fixture(autouse=True)
def _no_variables(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("MUJOCO_GL", "PYOPENGL_PLATFORM", *opengl.DECISIVE):
        monkeypatch.delenv(name, raising=False)


@pytest.mark.parametrize(
    ("wanted", "there", "expected"),
    [
        ("", {"EGL", "GL"}, "egl"),
        ("", {"EGL", "GL", "OSMesa"}, "egl"),
        ("", {"EGL", "OSMesa"}, "osmesa"),
        ("OSMesa", {"EGL", "GL", "OSMesa"}, "osmesa"),
        ("glfw", {"EGL", "GL"}, "egl"),
        ("disable", {"OSMesa"}, "osmesa"),
    ],
)
def test_backend(wanted: str, there: set[str], expected: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MUJOCO_GL", wanted)
    monkeypatch.setattr(opengl, "loads", there.__contains__)
    assert choose_backend() == expected


@pytest.mark.parametrize(
    ("wanted", "there", "message"),
    [
        ("", set(), "cannot render with egl: libEGL and libGL missing; install it with: apt-get install -y libegl1 "),
        ("", {"GL"}, "cannot render with egl: libEGL missing; "),
        ("egl", {"GL", "OSMesa"}, r"cannot render with egl \(chosen by MUJOCO_GL=egl\): libEGL missing; "),
        ("osmesa", {"EGL", "GL"}, r"osmesa \(chosen by MUJOCO_GL=osmesa\): libOSMesa missing; .* libosmesa6$"),
        ("mesa", {"EGL", "GL"}, "^MUJOCO_GL=mesa: no such OpenGL backend; set it to egl or osmesa, or unset it$"),
    ],
)
def test_what_is_missing_or_wrong_is_named(
    wanted: str, there: set[str], message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MUJOCO_GL", wanted)
    monkeypatch.setattr(opengl, "loads", there.__contains__)
    monkeypatch.setattr("os.geteuid", lambda: 0)
    with pytest.raises(DependencyError, match=message):
        choose_backend()


def test_an_ordinary_user_is_given_a_line_that_works(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(opengl, "loads", lambda library: False)
    monkeypatch.setattr("os.geteuid", lambda: 1000)
    with pytest.raises(DependencyError, match="install it with: sudo apt-get install -y libegl1"):
        choose_backend()


def test_another_platform_of_pyopengl_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(opengl, "loads", lambda library: True)
    monkeypatch.setenv("PYOPENGL_PLATFORM", "EGL")
    assert choose_backend() == "egl"
    monkeypatch.setenv("PYOPENGL_PLATFORM", "glx")
    with pytest.raises(DependencyError, match=r"^PYOPENGL_PLATFORM=glx: carecontact renders with egl; unset this var"):
        choose_backend()


def test_a_refusal_names_the_variables_that_decide_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(opengl, "loads", lambda library: True)
    message = str(cannot_render(ImportError("no device.\nIs there a driver?")))
    assert message.startswith("cannot render with egl: no device. Is there a driver?; if a driver is missing, install")
    monkeypatch.setenv("MUJOCO_EGL_DEVICE_ID", "7")
    message = str(cannot_render(ImportError("no device")))
    assert message.startswith("cannot render with egl: no device; ")
    assert message.endswith(": MUJOCO_EGL_DEVICE_ID=7")


def test_used_up_memory_or_threads_are_not_blamed_on_opengl(monkeypatch: pytest.MonkeyPatch) -> None:
    def kind(width: int, height: int) -> None:
        raise MemoryError

    monkeypatch.setattr(opengl, "import_opengl", lambda: kind)
    with pytest.raises(MemoryError):
        make_context(8, 8)

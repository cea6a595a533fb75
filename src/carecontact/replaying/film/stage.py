"""Draws a world for a video: in any size, with smooth edges, and with soft shadows where the camera looks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt

from carecontact.errors import DependencyError
from carecontact.replaying.film.grid import SkinGrid, eye_of
from carecontact.replaying.film.skin import FilmSkin
from carecontact.sim.opengl import import_opengl

F64 = npt.NDArray[np.float64]
Picture = npt.NDArray[np.uint8]

SAMPLES = 4
"""Number of samples for each pixel (multisampling)."""
SHADOW_SIZE = 2048
"""Pixels of the shadow map, each way."""
KEY_DIRECTION = (-0.40, -0.62, -0.68)
"""Direction in which the lamp shines that casts shadows."""
KEY_SPREAD = 0.03
"""How far the directions differ where several lamps stand for this one [rad]."""
FILL_DIRECTION = (0.55, 0.65, -0.5)
SHOULDER_DEG = 15.0
"""Level angle between the camera's direction and that of a lamp that turns with it."""
KEY, FILL, AMBIENT, HEADLIGHT = 0.58, 0.20, 0.30, 0.14
"""Strengths."""
LAMP_DISTANCE_M = 2.0
KEY_AZIMUTH_DEG = float(np.degrees(np.arctan2(KEY_DIRECTION[1], KEY_DIRECTION[0])))


@dataclass(frozen=True, kw_only=True)
class View:
    """The place of a film's camera at one moment."""

    look_at: F64
    """(3,) [m]"""
    distance_m: float
    azimuth_deg: float
    elevation_deg: float
    radius_m: float
    """Radius round ``look_at`` within which shadows are drawn; 0 draws none."""
    camera: str | None = None
    """Name of a camera of the protocol, which is used instead of the numbers above."""
    fovy_deg: float = 40.0
    light_turns: bool = False
    """Whether the shadow-casting lamp shines over the camera's shoulder, wherever the camera stands, instead of from
    its place in the room."""


class Stage:
    """One OpenGL context for pictures of one size at most. Use it as a context manager."""

    def __init__(self, model: mujoco.MjModel, skin: FilmSkin, *, width: int, height: int, lamps: int) -> None:
        """
        Args:
            model: a film's (``film.skin.film_scene``).
            skin: of the same model.
            lamps: how many stand for one broad lamp: where only some of them are covered, the shadow is soft. Each
                costs as much as the rest of a picture.

        Raises DependencyError where nothing can be rendered.
        """
        self._model = model
        self._lamps = lamps
        self._skin = skin
        quality, far = model.vis.quality, model.vis.global_
        quality.offsamples, quality.shadowsize = SAMPLES, SHADOW_SIZE
        far.offwidth, far.offheight = width, height
        model.vis.map.zfar = 8.0
        try:
            self._context: Any = import_opengl()(width, height)
            self._context.make_current()
            self._mjr = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100.value)
        except (RuntimeError, AttributeError, mujoco.FatalError) as error:
            raise DependencyError(f"cannot render a picture of {width} x {height}: {error}") from None
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, self._mjr)
        self._option = mujoco.MjvOption()
        self._made = mujoco.MjvScene(model, maxgeom=4 * model.ngeom + 2000)
        self._made.flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = False
        self._mjr.readDepthMap = mujoco.mjtDepthMap.mjDEPTH_ZEROFAR.value

    def __enter__(self) -> Stage:
        return self

    def __exit__(self, *_: object) -> None:
        self._context.make_current()
        self._mjr.free()
        self._context.free()

    def picture(
        self, data: mujoco.MjData, view: View, size: tuple[int, int], *, grid: SkinGrid | None = None
    ) -> Picture:
        """(height, width, 3) of the world at ``data``, whose kinematics are current; ``size``: (width, height)."""
        self._context.make_current()
        made, camera = self._made, mujoco.MjvCamera()
        if view.camera is not None:
            camera.type, camera.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, self._model.camera(view.camera).id
        else:
            camera.type, camera.lookat, camera.distance = mujoco.mjtCamera.mjCAMERA_FREE, view.look_at, view.distance_m
            camera.azimuth, camera.elevation = view.azimuth_deg, view.elevation_deg
            self._model.vis.global_.fovy = view.fovy_deg
        mujoco.mjv_updateScene(
            self._model, data, self._option, mujoco.MjvPerturb(), camera, mujoco.mjtCatBit.mjCAT_ALL.value, made
        )
        vertices, _ = self._skin.shape(data, made)
        self._light(view)
        rect, out = mujoco.MjrRect(0, 0, *size), np.empty((size[1], size[0], 3), np.uint8)
        depth = None if grid is None else np.empty((size[1], size[0]), np.float32)
        mujoco.mjr_render(rect, made, self._mjr)
        mujoco.mjr_readPixels(out, depth, rect, self._mjr)
        out = np.ascontiguousarray(out[::-1])
        if grid is not None and depth is not None:
            grid.draw(out, self._metres(depth[::-1]), vertices, eye_of(made, size))
        return out

    def _metres(self, buffer: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
        extent, planes = self._model.stat.extent, self._model.vis.map
        near, far = planes.znear * extent, planes.zfar * extent
        # MuJoCo stores reversed depth: 1 at the near plane, 0 at the far plane.
        return (near * far / (buffer.astype(np.float64) * (far - near) + near)).astype(np.float32)

    def _light(self, view: View) -> None:
        made = self._made
        head = made.lights[0]
        self._mjr.shadowClip = view.radius_m
        made.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = view.radius_m > 0
        turn_deg = view.azimuth_deg + SHOULDER_DEG - KEY_AZIMUTH_DEG if view.light_turns else 0.0
        lamps = [turned(direction, turn_deg) for direction in key_directions(self._lamps)]
        made.nlight = 2 + len(lamps)
        for lamp, direction, diffuse, shadow in (
            (head, (0.0, 0.0, -1.0), HEADLIGHT, False),
            *((made.lights[1 + k], d, KEY / len(lamps), True) for k, d in enumerate(lamps)),
            (made.lights[1 + len(lamps)], turned(np.array(FILL_DIRECTION), turn_deg), FILL, False),
        ):
            lamp.type = mujoco.mjtLightType.mjLIGHT_DIRECTIONAL
            if lamp is not head:
                lamp.dir = np.asarray(direction) / np.linalg.norm(direction)
                lamp.pos = view.look_at - LAMP_DISTANCE_M * lamp.dir
            lamp.headlight, lamp.castshadow, lamp.texid = int(lamp is head), int(shadow), -1
            lamp.ambient[:] = AMBIENT if lamp is head else 0.0
            lamp.diffuse[:] = diffuse
            lamp.specular[:] = 0.25 * diffuse * (not lamp.headlight)
            lamp.attenuation[:] = (1, 0, 0)


def key_directions(count: int) -> list[F64]:
    """(3,) directions round KEY_DIRECTION, evenly on a small circle."""
    middle = np.array(KEY_DIRECTION) / np.linalg.norm(KEY_DIRECTION)
    across = np.cross(middle, [0.0, 0.0, 1.0])
    across /= np.linalg.norm(across)
    along = np.cross(middle, across)
    turns = 2 * np.pi * np.arange(count) / count + 0.4
    return [middle + KEY_SPREAD * (np.cos(t) * across + np.sin(t) * along) for t in turns]


def turned(direction: F64, turn_deg: float) -> F64:
    """(3,) a direction after a turn about the vertical."""
    sine, cosine = np.sin(np.radians(turn_deg)), np.cos(np.radians(turn_deg))
    x, y, z = direction
    return np.array([cosine * x - sine * y, sine * x + cosine * y, z])

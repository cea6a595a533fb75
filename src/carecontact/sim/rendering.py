"""Camera images of a scene, headless: one OpenGL context per process, made for the first image."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt

from carecontact.errors import SceneError
from carecontact.protocol.protocol import Protocol
from carecontact.protocol.sections import Camera
from carecontact.sim.opengl import cannot_render, drawn_by, make_context
from carecontact.sim.state import Proprioception
from carecontact.world.robot import VISUAL_GROUP
from carecontact.world.room import FURNITURE_GROUP

Bool = npt.NDArray[np.bool_]
F32 = npt.NDArray[np.float32]
F64 = npt.NDArray[np.float64]

DEPTH_RANGE_M = 6.0
"""Beyond this a depth pixel is NaN: the working range of a room-scale RGB-D camera (assumed)."""

_CV_FROM_GL = np.diag([1.0, -1.0, -1.0])


def _geoms_only(group: int) -> mujoco.MjvOption:
    """Shows the geoms of one group, and no skin, site or flex."""
    option = mujoco.MjvOption()
    for groups in ("geomgroup", "sitegroup", "skingroup", "flexgroup", "jointgroup", "tendongroup", "actuatorgroup"):
        getattr(option, groups)[:] = 0
    option.geomgroup[group] = 1
    return option


@dataclass(frozen=True, kw_only=True)
class TrueView:
    human: Bool
    """(H, W) the person is the nearest thing there."""
    depth: F32
    """(H, W) [m], as ``SceneRenderer.depth``"""


class SceneRenderer:
    """Images from the cameras that the protocol names; sizes come from the protocol, optics from the model.

    Without shadows and multisampling, which cost five times the rest together. Pixel (row j, column i) has its centre
    at u = i, v = j. ``renders`` counts images by kind: ``rgb``, ``depth``, ``robot_depth``, ``cell_depth``,
    ``free_view`` and ``truth``.
    """

    def __init__(
        self, model: mujoco.MjModel, *, protocol: Protocol, calibration: Mapping[str, F64] | None = None
    ) -> None:
        """``calibration``: camera -> (4, 4) error in its frame of where the cell believes it to be; none by default."""
        self._model, self.protocol, self.calibration = model, protocol, dict(calibration or {})
        self.proprioception = Proprioception(model, protocol.scene.robot)
        self._cameras: dict[str, Camera] = {str(name): camera for name, camera in protocol.cameras.items()}
        self._context: Any = None
        self._mjr: mujoco.MjrContext | None = None
        self._scene: mujoco.MjvScene | None = None
        self._calibrated: mujoco.MjData | None = None
        self._everything = mujoco.MjvOption()
        self._robot_only, self._furniture_only = _geoms_only(VISUAL_GROUP), _geoms_only(FURNITURE_GROUP)
        self._empty_cell: dict[str, F32] = {}
        self._stale_skin = False
        self.renders: Counter[str] = Counter()
        self.drawn_by = "nothing was drawn"
        """Vendor, renderer and version, as OpenGL names what draws the images."""

    def rgb(self, data: mujoco.MjData, camera: str) -> npt.NDArray[np.uint8]:
        """(H, W, 3) colour image."""
        self.renders["rgb"] += 1
        self._draw(data, camera, self._everything)
        return self._colours(camera)

    def depth(self, data: mujoco.MjData, camera: str) -> F32:
        """(H, W) distance along the optical axis [m]; NaN beyond DEPTH_RANGE_M."""
        self.renders["depth"] += 1
        return self._depth(data, camera, self._everything)

    def free_view(
        self,
        data: mujoco.MjData,
        *,
        look_at: npt.ArrayLike,
        distance_m: float,
        azimuth_deg: float,
        elevation_deg: float,
        size_of: str,
        edit: Callable[[mujoco.MjvScene], None] | None = None,
    ) -> npt.NDArray[np.uint8]:
        """(H, W, 3) from a free camera, as large as camera ``size_of``; for reports, never for a policy.

        ``edit`` may change the prepared scene before it is drawn.
        """
        self.renders["free_view"] += 1
        view = mujoco.MjvCamera()
        view.type = mujoco.mjtCamera.mjCAMERA_FREE
        view.lookat, view.distance = np.asarray(look_at, np.float64), distance_m
        view.azimuth, view.elevation = azimuth_deg, elevation_deg
        self._draw(data, size_of, self._everything, view=view, edit=edit)
        return self._colours(size_of)

    def robot_depth(self, joint_position: npt.ArrayLike, camera: str) -> F32:
        """(H, W) depth [m] of the robot alone at the given encoder angles [rad]; NaN where no robot is.

        A real cell can compute it too: it knows its robot's shape, its encoders and its calibration.
        """
        self.renders["robot_depth"] += 1
        return self._depth(self.at_encoders(joint_position), camera, self._robot_only)

    def cell_depth(self, joint_position: npt.ArrayLike, camera: str) -> F32:
        """(H, W) depth [m] of bed, pillow, arm board and room without person and robot; NaN beyond DEPTH_RANGE_M.

        A real cell has it from a map of itself, with pillow and board in their places and an empty bed, seen from
        where the cell believes the camera to be; for a camera on the hand, at the encoder angles [rad]. A camera
        that stands is rendered once.
        """
        if camera in self._empty_cell:
            return self._empty_cell[camera].copy()
        self.renders["cell_depth"] += 1
        depth = self._depth(self.at_encoders(joint_position), camera, self._furniture_only)
        if self._cameras[camera].mount == "world":
            self._empty_cell[camera] = depth.copy()
        return depth

    def truth(self, data: mujoco.MjData, camera: str) -> TrueView:
        """What is seen, by the simulator's own labels; for the scorer, never for a policy."""
        self.renders["truth"] += 1
        self._draw(data, camera, self._everything, flat=True)
        _, scene = self._prepared()
        skin = int(mujoco.mjtObj.mjOBJ_SKIN)
        # MuJoCo writes label + 1 as a 24-bit number, red lowest.
        mine = [g.segid + 1 for g in scene.geoms[: scene.ngeom] if g.objtype == skin]
        label = self._colours(camera).astype(np.int32) @ np.array([1, 1 << 8, 1 << 16])
        return TrueView(human=np.isin(label, mine), depth=self._metres(camera))

    def at_encoders(self, joint_position: npt.ArrayLike) -> mujoco.MjData:
        """The world as encoders [rad] and calibration know it, without the person; valid until the next call."""
        if self._calibrated is None:
            self._calibrated = mujoco.MjData(self._model)
        data: mujoco.MjData = self._calibrated
        self.proprioception.set_joint_position(data, joint_position)
        mujoco.mj_kinematics(self._model, data)
        mujoco.mj_camlight(self._model, data)
        for name, error in self.calibration.items():
            position, matrix = data.cam_xpos[self._model.camera(name).id], data.cam_xmat[self._model.camera(name).id]
            rotation = matrix.reshape(3, 3) @ _CV_FROM_GL
            position += rotation @ error[:3, 3]
            matrix[:] = (rotation @ error[:3, :3] @ _CV_FROM_GL).ravel()
        return data

    def size(self, camera: str) -> tuple[int, int]:
        """(width, height) [px]. Raises SceneError for a camera that the protocol does not name."""
        if camera not in self._cameras:
            raise SceneError(f"no camera {camera!r}; valid: {', '.join(sorted(self._cameras))}")
        return self._cameras[camera].width, self._cameras[camera].height

    def intrinsics(self, camera: str) -> F64:
        """(3, 3) pinhole matrix [px] for pixel centres at whole numbers."""
        width, height = self.size(camera)
        fovy = np.radians(float(self._model.cam_fovy[self._model.camera(camera).id]))
        focal = 0.5 * height / np.tan(0.5 * fovy)
        return np.array([[focal, 0.0, 0.5 * (width - 1)], [0.0, focal, 0.5 * (height - 1)], [0.0, 0.0, 1.0]])

    def pose_camera_in_base(self, data: mujoco.MjData, camera: str) -> F64:
        """(4, 4) camera -> robot base; camera axes x right, y down, z forward. Of ``data`` from ``at_encoders``: where
        the cell believes the camera to be."""
        index = self._model.camera(camera).id
        rotation = data.cam_xmat[index].reshape(3, 3) @ _CV_FROM_GL
        return self.proprioception.in_base(data, data.cam_xpos[index], rotation)

    def skin_changed(self) -> None:
        """Have the next colour image show the skin's texture as the model has it now; a new context does so anyway."""
        self._stale_skin = self._mjr is not None

    def close(self) -> None:
        """Give the OpenGL context back; a later image makes a new one."""
        if self._mjr is not None:
            self._context.make_current()
            self._mjr.free()
            self._context.free()
        self._mjr = self._context = self._scene = None

    def __enter__(self) -> SceneRenderer:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _depth(self, data: mujoco.MjData, camera: str, option: mujoco.MjvOption) -> F32:
        # Flat colours are enough for depth, and faster.
        self._draw(data, camera, option, flat=True)
        return self._metres(camera)

    def _draw(
        self,
        data: mujoco.MjData,
        camera: str,
        option: mujoco.MjvOption,
        *,
        flat: bool = False,
        view: mujoco.MjvCamera | None = None,
        edit: Callable[[mujoco.MjvScene], None] | None = None,
    ) -> None:
        """Draw in the size of a camera and what that camera sees, or another view."""
        size = self.size(camera)
        fixed = mujoco.MjvCamera()
        fixed.type = mujoco.mjtCamera.mjCAMERA_FIXED
        fixed.fixedcamid = self._model.camera(camera).id
        mjr, scene = self._prepared()
        if self._stale_skin and not flat:
            mujoco.mjr_uploadTexture(self._model, mjr, self._model.texture("human_skin").id)
            self._stale_skin = False
        everything = mujoco.mjtCatBit.mjCAT_ALL.value
        mujoco.mjv_updateScene(self._model, data, option, mujoco.MjvPerturb(), view or fixed, everything, scene)
        if edit is not None:
            edit(scene)
        scene.flags[mujoco.mjtRndFlag.mjRND_SEGMENT] = scene.flags[mujoco.mjtRndFlag.mjRND_IDCOLOR] = flat
        mujoco.mjr_render(mujoco.MjrRect(0, 0, *size), scene, mjr)

    def _colours(self, camera: str) -> npt.NDArray[np.uint8]:
        """Return the colours (H, W, 3) of the last drawing."""
        width, height = self.size(camera)
        image = np.empty((height, width, 3), np.uint8)
        mujoco.mjr_readPixels(image, None, mujoco.MjrRect(0, 0, width, height), self._prepared()[0])
        return np.ascontiguousarray(image[::-1])

    def _metres(self, camera: str) -> F32:
        """Return the depth (H, W) [m] of the last drawing."""
        width, height = self.size(camera)
        buffer = np.empty((height, width), np.float32)
        mujoco.mjr_readPixels(None, buffer, mujoco.MjrRect(0, 0, width, height), self._prepared()[0])
        near = self._model.vis.map.znear * self._model.stat.extent
        far = self._model.vis.map.zfar * self._model.stat.extent
        # MuJoCo stores reversed depth: 1 at the near plane, 0 at the far plane.
        metres = near * far / (buffer[::-1].astype(np.float64) * (far - near) + near)
        metres[metres > min(DEPTH_RANGE_M, 0.999 * far)] = np.nan
        return metres.astype(np.float32)

    def _prepared(self) -> tuple[mujoco.MjrContext, mujoco.MjvScene]:
        if self._mjr is not None and self._scene is not None:
            self._context.make_current()
            return self._mjr, self._scene
        width = max(camera.width for camera in self._cameras.values())
        height = max(camera.height for camera in self._cameras.values())
        self._context = make_context(width, height)
        self.drawn_by = drawn_by()
        quality = self._model.vis.quality
        samples, quality.offsamples = quality.offsamples, 0
        try:
            mjr = self._mjr = mujoco.MjrContext(self._model, mujoco.mjtFontScale.mjFONTSCALE_100.value)
        except mujoco.FatalError as error:  # such as a driver whose OpenGL is too old
            raise cannot_render(error) from error
        finally:
            quality.offsamples = samples
        mujoco.mjr_resizeOffscreen(width, height, mjr)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, mjr)
        mjr.readDepthMap = mujoco.mjtDepthMap.mjDEPTH_ZEROFAR.value
        scene = self._scene = mujoco.MjvScene(self._model, maxgeom=4 * self._model.ngeom + 1000)
        scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = False
        scene.flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = False
        return mjr, scene

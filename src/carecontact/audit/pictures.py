"""A second renderer: it draws the pictures of a state without any code of the renderer that made the policy's."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt
from mujoco.gl_context import GLContext

from carecontact.contract.protocol import Camera, Protocol
from carecontact.sim.rendering import DEPTH_RANGE_M
from carecontact.world.cameras import add_cameras
from carecontact.world.furniture import SUPPORT, add_furniture, add_light
from carecontact.world.human.library import load_body
from carecontact.world.human.pose import root_position
from carecontact.world.robot import add_robot

F64 = npt.NDArray[np.float64]


class Pictures:
    """Draws pictures of one model without shadows and multisampling, as the cell's cameras do. MUJOCO_GL names the
    backend.
    """

    def __init__(self, model: mujoco.MjModel, cameras: dict[str, Camera]) -> None:
        self.model, self._cameras = model, cameras
        width, height = (max(getattr(c, side) for c in cameras.values()) for side in ("width", "height"))
        model.vis.quality.offsamples = 0
        self._context: Any = GLContext(width, height)
        self._context.make_current()
        self._mjr = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100.value)
        mujoco.mjr_resizeOffscreen(width, height, self._mjr)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, self._mjr)
        self._mjr.readDepthMap = mujoco.mjtDepthMap.mjDEPTH_ZEROFAR.value
        self._scene = mujoco.MjvScene(model, maxgeom=4 * model.ngeom + 1000)
        self._scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = False
        self._scene.flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = False

    def rgb(self, data: mujoco.MjData, camera: str) -> npt.NDArray[np.uint8]:
        """Return the colour image (H, W, 3) of a camera."""
        image = np.empty((*self._size(camera), 3), np.uint8)
        self._draw(data, camera, None, image, None)
        return np.ascontiguousarray(image[::-1])

    def depth(self, data: mujoco.MjData, camera: str, *, group: int | None = None) -> npt.NDArray[np.float32]:
        """Return the depth (H, W) [m] along the optical axis, NaN beyond DEPTH_RANGE_M.

        ``group``: the only group of geoms that is drawn; None draws all.
        """
        buffer = np.empty(self._size(camera), np.float32)
        self._draw(data, camera, group, None, buffer)
        near, far = (self.model.stat.extent * clip for clip in (self.model.vis.map.znear, self.model.vis.map.zfar))
        # Reversed depth: 1 at the near plane, 0 at the far plane.
        metres = near * far / (buffer[::-1].astype(np.float64) * (far - near) + near)
        metres[metres > min(DEPTH_RANGE_M, 0.999 * far)] = np.nan
        return metres.astype(np.float32)

    def _size(self, camera: str) -> tuple[int, int]:
        return self._cameras[camera].height, self._cameras[camera].width

    def _draw(
        self,
        data: mujoco.MjData,
        camera: str,
        group: int | None,
        rgb: npt.NDArray[np.uint8] | None,
        depth: npt.NDArray[np.float32] | None,
    ) -> None:
        self._context.make_current()
        option, view = mujoco.MjvOption(), mujoco.MjvCamera()
        if group is not None:
            for groups in ("geomgroup", "sitegroup", "skingroup", "flexgroup", "tendongroup"):
                getattr(option, groups)[:] = 0
            option.geomgroup[group] = 1
        view.type, view.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, self.model.camera(camera).id
        mujoco.mjv_updateScene(
            self.model, data, option, mujoco.MjvPerturb(), view, mujoco.mjtCatBit.mjCAT_ALL.value, self._scene
        )
        height, width = self._size(camera)
        rect = mujoco.MjrRect(0, 0, width, height)
        mujoco.mjr_render(rect, self._scene, self._mjr)
        mujoco.mjr_readPixels(rgb, depth, rect, self._mjr)


def cell_model(protocol: Protocol, *, like: mujoco.MjModel | None = None) -> mujoco.MjModel:
    """Return the model of the empty cell: robot, furniture, light and cameras, but no person.

    ``like``: the model with the person, from which pillow and arm board take their place and pictures their clip
    planes.
    """
    spec, body = mujoco.MjSpec(), load_body(protocol.person.body)
    spec.compiler.degree = False
    add_robot(spec, protocol)
    x, y, _ = root_position(body, protocol.scene.mattress_top_m)
    # The pillow lies under the head, as ``world.scene`` has it.
    head_x = x + body.joint_centre["head"][2] - body.joint_centre["pelvis"][2] + 0.04
    add_furniture(spec, protocol.scene, head_x=float(head_x), head_y=float(y))
    add_light(spec)
    add_cameras(spec, protocol)
    model = spec.compile()
    if like is not None:
        model.stat.extent = like.stat.extent
        model.body(SUPPORT).pos[:], model.body(SUPPORT).quat[:] = like.body(SUPPORT).pos, like.body(SUPPORT).quat
    return model

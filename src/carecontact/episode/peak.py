"""The moment of a trial that its report shows: two pictures, and the shape of the skin at that moment."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt

from carecontact.sim.close_up import render_close_up, skin_shift
from carecontact.sim.rendering import SceneRenderer
from carecontact.sim.simulation import Simulation
from carecontact.sim.true_skin import skin_in_world

F64 = npt.NDArray[np.float64]
MARGIN_M = (0.08, 0.06, 0.06)
"""How far [m] beyond a region the skin is kept: along it, across it and outward."""


class Peak:
    """Remembers the state with the largest force on the target; while the target has not been touched, on any
    segment.
    """

    def __init__(self, simulation: Simulation, *, target: int) -> None:
        """``target``: column of the target's segment in the forces."""
        self._simulation, self._target = simulation, target
        self._force_n, self._on_target, self._time_s = 0.0, False, 0.0
        self._state: F64 | None = None

    def look(self, force_n: F64) -> None:
        """Consider the period that has just ended. ``force_n``: (n, S) magnitudes [N] of its forces."""
        best = force_n.max(0)
        on_target = bool(best[self._target] > 0)
        segment = self._target if on_target else int(best.argmax())
        better = best[segment] > self._force_n if on_target == self._on_target else on_target
        if best[segment] > 0 and better:
            self._force_n, self._on_target = float(best[segment]), on_target
            self._time_s, self._state = self._simulation.time_s, self._simulation.integration_state()

    def pictures(self, renderer: SceneRenderer, *, region: str) -> Mapping[str, npt.NDArray[Any]]:
        """Return the pictures of the room and of the contact from near, and the region's skin, as ``report/*``.

        They show the peak, or the end of a trial without contact.
        """
        model = self._simulation.model
        data = mujoco.MjData(model)
        state = self._simulation.integration_state() if self._state is None else self._state
        mujoco.mj_setState(model, data, state, int(mujoco.mjtState.mjSTATE_INTEGRATION))
        mujoco.mj_forward(model, data)
        shift = skin_shift(self._simulation.scene, data)
        close = render_close_up(renderer, self._simulation.scene, data, region=region, shift=shift)
        return {
            "report/snapshot_rgb": renderer.rgb(data, "exterior"),
            "report/peak_rgb": close.image,
            "report/peak_pose_camera_in_world": close.pose_camera_in_world.astype("<f8"),
            "report/peak_focal_px": np.array([close.focal_px], "<f8"),
            "report/peak_time_s": np.array([self._time_s], "<f8"),
            **self._skin(data, region, shift),
        }

    def _skin(self, data: mujoco.MjData, region: str, shift: F64) -> Mapping[str, npt.NDArray[Any]]:
        """Return the skin around the region, indented by ``shift`` (V, 3) [m] as it was at that moment."""
        scene, model = self._simulation.scene, self._simulation.model
        frame = scene.frames[region]
        bind = np.asarray(model.skin_vert, np.float64).reshape(-1, 3)
        length, half_width, outward = frame.size_m.tolist()
        reach = np.array([length / 2, half_width, outward]) + MARGIN_M
        near = np.all(np.abs((bind - frame.origin) @ frame.axes) < reach, axis=1)
        faces = np.asarray(model.skin_face).reshape(-1, 3)
        faces = faces[np.all(near[faces], axis=1)]
        kept = np.unique(faces)
        placed = (skin_in_world(model, data) + shift)[kept]
        return {
            "report/skin_in_world": placed.astype("<f4"),
            "report/skin_faces": np.searchsorted(kept, faces).astype("<i4"),
        }

"""Foam in a trial: what the tool wipes off in each control period, and the texture that shows what is left."""

from __future__ import annotations

import numpy as np

from carecontact.human.foam import FoamPatch
from carecontact.interface.geometry import quat_from_matrix
from carecontact.scoring.foam import FELT, SHARE, Arrays, new_wiping, share_of_tool
from carecontact.sim.rendering import SceneRenderer
from carecontact.sim.simulation import Samples, Simulation


def foam_arrays(patch: FoamPatch | None) -> dict[str, np.ndarray]:
    """Return what a recording holds of the foam."""
    if patch is None:
        return {}
    return {
        "scorer/foam_pose_in_region": np.concatenate([patch.middle, quat_from_matrix(patch.axes)]).astype("<f8"),
        "scorer/foam_half_m": np.array(patch.half_m, "<f8"),
        SHARE: patch.cell_share.astype("<f4"),
    }


class Foam:
    """The foam of one trial. It changes when the policy looks, and at no other time."""

    def __init__(self, simulation: Simulation, target: int, constants: Arrays, renderer: SceneRenderer) -> None:
        """Put all of the foam back onto the skin of a world at t = 0, whatever a trial before has wiped off it.

        Args:
            target: column of the named region's segment.
            constants: those of the trial's recording.
            renderer: draws the trial's pictures.
        """
        self._model, self._patch, self._target = simulation.model, simulation.scene.foam, target
        self._wiping, self._renderer = new_wiping(constants), renderer
        self._before_s, self._touched = 0.0, False
        if self._patch is not None:
            self._shown = np.ones(len(self._patch.cell_share))
            self._paint(self._patch)

    @property
    def present(self) -> bool:
        """Whether there is any foam."""
        return self._wiping is not None

    def add(self, time_s: float, samples: list[Samples], felt: Arrays) -> None:
        """Add the control period that ends at ``time_s``. ``felt``: what its row of the recording says of the cells."""
        if self._wiping is None:
            return
        # As the recording holds them, so that the scorer finds the same from it.
        mine = [(s.normal[:, self._target], s.beside_normal) for s in samples]
        normal = np.concatenate([normal for normal, _ in mine]).astype(np.float32)
        beside = [np.zeros((len(own), 2)) if b is None else b[..., self._target] for own, b in mine]
        press, slip, touch = (felt[path].astype(np.float32).astype(np.float64) for path in FELT)
        share = share_of_tool(normal, np.concatenate(beside).astype(np.float32))
        period_s, self._before_s = time_s - self._before_s, time_s
        self._touched |= self._wiping.add(period_s, press_ns=press, slip_m3=slip, touch_m2s=touch, tool_share=share)

    def show(self) -> None:
        """Paint what is left for the next pictures, where that has changed since the last look."""
        if self._wiping is None or self._patch is None or not self._touched:
            return
        left, self._touched = self._wiping.left, False
        if not np.array_equal(left, self._shown):
            self._shown = left
            self._paint(self._patch)

    def _paint(self, patch: FoamPatch) -> None:
        patch.paint(self._model, self._shown)
        self._renderer.skin_changed()

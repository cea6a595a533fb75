"""The moment of a trial that its report shows, and the two pictures of it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt

from carecontact.sim.close_up import render_close_up
from carecontact.sim.rendering import SceneRenderer
from carecontact.sim.simulation import Simulation

F64 = npt.NDArray[np.float64]


class Peak:
    """Remembers the state with the largest force on the target, or on anything while the target was never touched."""

    def __init__(self, simulation: Simulation, *, target: int) -> None:
        """``target``: column of the target's segment in the forces."""
        self._simulation, self._target = simulation, target
        self._force_n, self._on_target, self._time_s = 0.0, False, 0.0
        self._state: F64 | None = None

    def look(self, force_n: F64) -> None:
        """``force_n``: (n, S) norms of the forces of the period that has just ended."""
        best = force_n.max(0)
        on_target = bool(best[self._target] > 0)
        segment = self._target if on_target else int(best.argmax())
        better = best[segment] > self._force_n if on_target == self._on_target else on_target
        if best[segment] > 0 and better:
            self._force_n, self._on_target = float(best[segment]), on_target
            self._time_s, self._state = self._simulation.time_s, self._simulation.integration_state()

    def pictures(self, renderer: SceneRenderer, *, region: str) -> Mapping[str, npt.NDArray[Any]]:
        """The room and the contact from near, at the peak or at the end of a trial without contact, as ``report/*``."""
        model = self._simulation.model
        data = mujoco.MjData(model)
        state = self._simulation.integration_state() if self._state is None else self._state
        mujoco.mj_setState(model, data, state, int(mujoco.mjtState.mjSTATE_INTEGRATION))
        mujoco.mj_forward(model, data)
        return {
            "report/snapshot_rgb": renderer.rgb(data, "exterior"),
            "report/peak_rgb": render_close_up(renderer, self._simulation.scene, data, region=region),
            "report/peak_time_s": np.array([self._time_s], "<f8"),
        }

"""What the declared cells of a trial's region felt in each control period, for its recording."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import numpy.typing as npt

from carecontact.kernel.readings import Cells
from carecontact.sim.simulation import Simulation

F64 = npt.NDArray[np.float64]
Rows = dict[str, F64]
SUMS = {f"scorer/cell_{field.name}": field.name for field in fields(Cells)}
"""Array of a recording -> field of ``Cells``."""


class CellLog:
    """Turns the running sums of the compiled tissue into the part of each control period; empty for a rigid region."""

    def __init__(self, simulation: Simulation, region: str) -> None:
        """Begin the first period now."""
        self._simulation, self._region = simulation, region
        self._before = self._sums()

    def constants(self) -> dict[str, npt.NDArray[np.float32]]:
        """Return the centres (C, 3) [m] in the region's frame and the areas (C,) [m²] of the cells, by their path."""
        scene = self._simulation.scene
        if self._region not in scene.regions:
            return {}
        cells, frame = scene.regions[self._region].cells, scene.frames[self._region]
        return {
            "scorer/cell_in_region": ((cells.centres - frame.origin) @ frame.axes).astype("<f4"),
            "scorer/cell_area_m2": cells.areas.astype("<f4"),
        }

    def period(self) -> Rows:
        """Return what each cell (C,) felt since the last call, by the path of the array."""
        now = self._sums()
        added = {path: now[path] - self._before[path] for path in now}
        self._before = now
        return added

    def _sums(self) -> Rows:
        tissue = self._simulation.tissue.get(self._region)
        if tissue is None:
            return {}
        cells = tissue.cells(self._simulation.data)
        return {path: getattr(cells, name) for path, name in SUMS.items()}

"""What the person of a trial did by itself, for its recording and never for its policy."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from carecontact.sim.simulation import Simulation

F64 = npt.NDArray[np.float64]


class LifeLog:
    """Every method gives arrays by their path; none where the person does nothing by itself."""

    def __init__(self, simulation: Simulation) -> None:
        self._life, self._data = simulation.life, simulation.data

    def constants(self) -> dict[str, npt.NDArray[Any]]:
        """When the arm changes its place, and by how much, as it was drawn before the trial."""
        if self._life is None:
            return {}
        moves = self._life.moves()
        return {
            "scorer/repositioning_s": moves[:, 0].astype("<f8"),
            "scorer/repositioning_rad": moves[:, 1].astype("<f8"),
        }

    def period(self) -> dict[str, F64]:
        """What holds at the end of a period."""
        if self._life is None:
            return {}
        life, data = self._life, self._data
        return {
            "scorer/breath_m": life.breath_m(data), "scorer/muscle_torque_nm": life.torque_nm(data),
            "scorer/muscle_work_j": life.work_j(data),
        }  # fmt: skip

    def ended(self) -> dict[str, npt.NDArray[Any]]:
        """When the arm was withdrawn."""
        return {} if self._life is None else {"scorer/withdrawal_s": self._life.pulls_s(self._data).astype("<f8")}

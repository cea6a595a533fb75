"""What the person of a trial did on their own, for the recording and never for the policy."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from carecontact.sim.simulation import Simulation

F64 = npt.NDArray[np.float64]


class LifeLog:
    """Collects the person's own movements. Every method returns arrays by their path; none if the person never moves on
    their own.
    """

    def __init__(self, simulation: Simulation) -> None:
        self._life, self._data = simulation.life, simulation.data

    def constants(self) -> dict[str, npt.NDArray[Any]]:
        """Return when the arm moves to another place, and by how much, as it was drawn before the trial."""
        if self._life is None:
            return {}
        moves = self._life.moves()
        return {
            "scorer/repositioning_s": moves[:, 0].astype("<f8"),
            "scorer/repositioning_rad": moves[:, 1].astype("<f8"),
        }

    def period(self) -> dict[str, F64]:
        """Return the values at the end of a control period."""
        if self._life is None:
            return {}
        life, data = self._life, self._data
        return {
            "scorer/breath_m": life.breath_m(data), "scorer/muscle_torque_nm": life.torque_nm(data),
            "scorer/muscle_work_j": life.work_j(data),
        }  # fmt: skip

    def ended(self) -> dict[str, npt.NDArray[Any]]:
        """Return when the person withdrew the arm."""
        return {} if self._life is None else {"scorer/withdrawal_s": self._life.pulls_s(self._data).astype("<f8")}

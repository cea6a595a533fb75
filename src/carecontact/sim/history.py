"""Reads every sensor's value at every physics step from ``MjData.history`` in one gather."""

from __future__ import annotations

import mujoco
import numpy as np
import numpy.typing as npt

from carecontact.errors import SceneError

F64 = npt.NDArray[np.float64]


class SensorHistory:
    """Samples of a control period.

    MuJoCo 4.0 lays a sensor's ring buffer out as: time of the last reading, index of the newest slot, ``n`` times,
    ``n`` values of the sensor's dimension.
    """

    HEADER = 2

    def __init__(self, model: mujoco.MjModel) -> None:
        counts = set(model.sensor_history[:, 0].tolist())
        if len(counts) != 1 or counts == {0}:
            raise SceneError(f"every scorer sensor must keep the same history, got sample counts {sorted(counts)}")
        self.samples = int(counts.pop())
        address, dim = model.sensor_historyadr, model.sensor_dim
        start = address + self.HEADER + self.samples
        # (samples, nsensordata): slot s of sensor i, component c lies at start_i + s * dim_i + c.
        columns = [start[i] + np.arange(dim[i]) for i in range(model.nsensor)]
        self._index = np.concatenate(columns)[None] + np.arange(self.samples)[:, None] * np.repeat(dim, dim)[None]
        self._cursor = int(address[0]) + 1
        self._times = int(address[0]) + self.HEADER
        self._columns = {
            model.sensor(i).name: slice(int(a), int(a + d))
            for i, (a, d) in enumerate(zip(model.sensor_adr, dim, strict=True))
        }

    def columns(self, sensor: str) -> slice:
        """Where a sensor's components are in a row of ``last``."""
        return self._columns[sensor]

    def last(self, data: mujoco.MjData, count: int) -> tuple[F64, F64]:
        """Times (count,) and values (count, nsensordata) of the last ``count`` steps, oldest first.

        A sample is taken with the forces of its step and stamped with the time at the step's start.
        """
        if not 0 < count <= self.samples:
            raise SceneError(f"count {count}: expected 1 to {self.samples}, the samples that the history keeps")
        history = data.history
        order = (int(history[self._cursor]) - np.arange(count - 1, -1, -1)) % self.samples
        return history.take(self._times + order), history.take(self._index.take(order, 0))

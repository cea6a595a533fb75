"""The true poses of a trial's cameras, and those that its policy was told."""

from __future__ import annotations

import mujoco
import numpy as np
import numpy.typing as npt

from carecontact.contract.geometry import quat_from_matrix
from carecontact.contract.observation import Observation
from carecontact.contract.policy import CAMERAS
from carecontact.sim.rendering import SceneRenderer

F64 = npt.NDArray[np.float64]

BELIEVED, TRUE = "policy/believed_pose_camera_in_base", "scorer/pose_camera_in_base"


class CameraPoses:
    """Collects told and true camera poses for a recording if the cell's calibration has an error; the true poses are
    for the scorer alone.
    """

    def __init__(self, renderer: SceneRenderer) -> None:
        self._renderer = renderer
        self._rows: dict[str, list[F64]] = {BELIEVED: [], TRUE: []}

    def add(self, data: mujoco.MjData, observation: Observation) -> None:
        """Add the poses of one observation. ``data``: the state that the observation shows; it is not changed."""
        if not self._renderer.calibration:
            return
        shown = {name: view.pose_camera_in_base for name, view in observation.cameras.items()}
        true = {name: self._renderer.pose_camera_in_base(data, name) for name in self._renderer.protocol.cameras}
        for path, poses, absent in ((BELIEVED, shown, np.nan), (TRUE, true, 0.0)):
            row = np.full((len(CAMERAS), 7), absent)
            for name, pose in poses.items():
                row[CAMERAS.index(name)] = [*pose[:3, 3], *quat_from_matrix(pose[:3, :3])]
            self._rows[path].append(row)

    def arrays(self) -> dict[str, F64]:
        """Return the arrays by their path; none if the calibration has no error or no observation was answered."""
        return {path: np.array(rows, "<f8") for path, rows in self._rows.items() if rows}

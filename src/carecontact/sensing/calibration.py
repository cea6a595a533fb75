"""Where the cameras stand by the cell's calibration, and where they really stand in the frame that a policy sees."""

from __future__ import annotations

from collections.abc import Mapping

import mujoco
import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from carecontact.interface.geometry import quat_from_matrix
from carecontact.interface.observation import Observation
from carecontact.interface.policy import CAMERAS
from carecontact.protocol.protocol import Protocol
from carecontact.sim.rendering import SceneRenderer

F64 = npt.NDArray[np.float64]
Calibration = Mapping[str, F64]
"""Fixed camera -> (4, 4) error in its own frame (x right, y down, z forward): believed pose = true pose @ error. A
camera on the hand has none; its pose follows the encoders."""
BELIEVED, TRUE = "policy/believed_pose_camera_in_base", "scorer/pose_camera_in_base"
"""Arrays of a recording: the poses that the policy received, and the true ones."""


def draw_calibration(rng: np.random.Generator, protocol: Protocol) -> dict[str, F64]:
    """Draw the error of every fixed camera of the protocol: a shift along and a rotation vector about each axis,
    normal with the protocol's standard deviations. Empty where both are 0.

    A camera has the same draws whichever other cameras the protocol names.
    """
    shift_m, turn_deg = protocol.variation.calibration_m, protocol.variation.calibration_deg
    if not (shift_m or turn_deg):
        return {}
    draws = rng.standard_normal((len(CAMERAS), 2, 3))
    errors: dict[str, F64] = {}
    for name, (shift, turn) in zip(CAMERAS, draws, strict=True):
        if name in protocol.cameras and protocol.cameras[name].mount == "world":
            errors[name] = np.eye(4)
            errors[name][:3, :3] = Rotation.from_rotvec(turn_deg * turn, degrees=True).as_matrix()
            errors[name][:3, 3] = shift_m * shift
    return errors


class CameraPoses:
    """Collects believed and true camera poses for a recording if the cell's calibration has an error; the true poses
    are for the scorer alone.
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

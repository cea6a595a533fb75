"""What one camera shows of the scene: parts of the person by name, and everything that is in the way."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from carecontact.contract.geometry import pixels
from carecontact.contract.observation import CameraView, Observation
from carecontact.policies.voxposer import fixed_values as fixed
from carecontact.policies.voxposer.grid import Grid
from carecontact.regions import REGIONS, STANDARD_REGIONS
from carecontact.sight import LANDMARK, PerceptionFailure, person_points, region_from_observation
from carecontact.sight.person import MIN_VISIBILITY

F64 = npt.NDArray[np.float64]
Bool = npt.NDArray[np.bool_]

GRIPPER = "gripper"
PARTS = {
    f"{side} {name.replace('_', ' ')}" if REGIONS[name].sided else name.replace("_", " "): (name, side)
    for name in STANDARD_REGIONS
    for side in (("right", "left") if REGIONS[name].sided else ("right",))
}
"""Name in a program -> region and side. The standard regions alone: the names are part of the prompt, by which recorded
completions are found."""
JOINTS = tuple(f"{side} {joint}" for side in ("right", "left") for joint in ("wrist", "elbow", "shoulder", "hip"))
NAMES = (GRIPPER, *PARTS, *JOINTS)
"""Every name that ``Scene.find`` takes."""


@dataclass(frozen=True, kw_only=True)
class Part:
    """Something that a program can request by name, in base."""

    name: str
    position_m: F64
    """(3,) mean of the visible points [m], as the published method summarises its detections; on a round part it lies a
    little below the top."""
    points_m: F64
    """(N, 3) visible points [m]."""
    normal: F64
    """(3,) unit vector out of the surface."""


class Scene:
    """The latest observation, and for each part the last place at which it was not hidden."""

    def __init__(self, camera: str, grid: Grid) -> None:
        """``camera``: name of the camera that is used; ``grid``: the voxels of ``occupied``."""
        self._camera, self.grid = camera, grid
        self._observation: Observation | None = None
        self._kept: dict[str, Part] = {}
        self._fresh: set[str] = set()

    def look(self, observation: Observation) -> None:
        """Take over a new observation."""
        self._observation = observation
        self._fresh = set()

    @property
    def pose_tcp(self) -> F64:
        """(7,) pose of the tool in base: position [m], quat_wxyz."""
        assert self._observation is not None
        return self._observation.pose_tcp_in_base

    def find(self, name: str) -> Part:
        """Return a part as the latest observation shows it, or as it was last seen if it is hidden or not found now.

        Raises KeyError for a name that is not in NAMES, and PerceptionFailure if the part has never been seen.
        """
        if name == GRIPPER:
            tcp = self.pose_tcp[:3]
            return Part(name=name, position_m=tcp, points_m=tcp[None], normal=np.array([0.0, 0.0, 1.0]))
        kept = self._kept.get(name)
        if name in self._fresh and kept is not None:
            return kept
        self._fresh.add(name)
        if kept is None:
            self._kept[name] = self._seen(name)
        elif not self._hidden(kept):
            try:
                self._kept[name] = self._seen(name)
            except PerceptionFailure:
                pass
        return self._kept[name]

    def occupied(self) -> Bool:
        """Return the (MAP_SIZE,) * 3 voxels that hold a visible surface other than the robot's."""
        view = self.view
        assert view.points is not None
        assert view.depth is not None
        assert view.masks is not None
        points = view.points[~view.masks["robot"][np.isfinite(view.depth)]].astype(np.float64)
        out = np.zeros(self.grid.shape, bool)
        out[tuple(self.grid.voxels(points[self.grid.contains(points)]).T)] = True
        return out

    def _seen(self, name: str) -> Part:
        if name in JOINTS:
            return self._joint(name)
        region, side = PARTS[name]
        assert self._observation is not None
        found = region_from_observation(self._observation, region, side=side, camera=self._camera)
        offset = person_points(self.view) - found.centre_m
        inside = (np.abs(offset @ found.axis) <= found.half_length_m) & (
            np.abs(offset @ found.lateral) <= found.radius_m
        )
        # Leave out what lies behind the limb in the picture: a limb is no higher than it is wide.
        inside &= np.abs(offset @ found.normal) <= found.radius_m
        points = offset[inside] + found.centre_m
        if len(points) == 0:
            raise PerceptionFailure(f"no surface of the {name} is visible")
        return Part(name=name, position_m=points.mean(axis=0), points_m=points, normal=found.normal)

    def _joint(self, name: str) -> Part:
        view = self.view
        if view.landmarks is None or view.landmarks_in_base is None:
            raise PerceptionFailure(f"camera {self._camera}: landmarks are needed")
        index = LANDMARK[name]
        visibility, place = float(view.landmarks[index, 2]), view.landmarks_in_base[index].astype(np.float64)
        if not visibility >= MIN_VISIBILITY or not np.isfinite(place).all():
            raise PerceptionFailure(f"{name} is hidden, has no depth, or nobody was found")
        person = person_points(view)
        near = person[np.linalg.norm(person - place, axis=1) < fixed.JOINT_RADIUS_M]
        points = near if len(near) else place[None]
        return Part(name=name, position_m=place, points_m=points, normal=np.array([0.0, 0.0, 1.0]))

    def _hidden(self, part: Part) -> bool:
        view = self.view
        assert view.masks is not None
        robot = view.masks["robot"]
        seen = np.rint(pixels(part.points_m, view.intrinsics, view.pose_camera_in_base)).astype(int)
        inside = ((seen >= 0) & (seen < [robot.shape[1], robot.shape[0]])).all(axis=1)
        covered = robot[seen[inside, 1], seen[inside, 0]]
        return len(covered) == 0 or float(covered.mean()) > fixed.OCCLUDED_SHARE

    @property
    def view(self) -> CameraView:
        """The camera's part of the latest observation."""
        assert self._observation is not None
        return self._observation.cameras[self._camera]

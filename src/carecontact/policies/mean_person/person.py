"""The places of the regions of a protocol's persons on average, in the overhead camera's frame."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, ConfigDict, ValidationError

from carecontact.errors import ConfigError
from carecontact.sight import RegionGeometry

F64 = npt.NDArray[np.float64]

FILE = "person.json"
"""tools/mean_person.py writes it."""


class MeanRegion(BaseModel):
    """Means over persons; lengths in metres."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    centre_in_camera: tuple[float, float, float]
    axis_in_camera: tuple[float, float, float]
    """Axis from proximal to distal (abdomen: to cranial), of any length."""
    radius_m: float
    half_length_m: float
    profile_m: tuple[tuple[float, float], ...]
    """Distance along the axis from the centre, and height of the skin over the line along the axis."""
    support_under_m: float | None
    """How far the centre is above what the limb lies on."""
    way_over_m: float
    """How far above the centre the robot travels over the person."""


class MeanPerson(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")

    made_by: str
    protocol: str
    protocol_sha256: str
    seeds: tuple[int, ...]
    """Seeds over which the means were taken."""
    camera: str
    regions: dict[str, MeanRegion]


def read_person(path: Path | None) -> MeanPerson:
    """Return the means in a file, or in one that is shipped beside FILE and is named without its suffix; None: FILE.
    Raises ConfigError for a file that cannot be read."""
    kept = resources.files(__package__ or __name__) / (FILE if path is None else f"{path}.json")
    try:
        return MeanPerson.model_validate_json((kept if path is None or kept.is_file() else path).read_bytes())
    except OSError as error:
        shipped = sorted(
            file.name.removesuffix(".json")
            for file in resources.files(__package__ or __name__).iterdir()
            if file.name.endswith(".json")
        )
        raise ConfigError(
            f"mean person {path or FILE}: {error.strerror}; valid: {', '.join(shipped)}, or a file that "
            "tools/mean_person.py wrote"
        ) from None
    except ValidationError as error:
        first = error.errors()[0]
        raise ConfigError(f"mean person {path or FILE}: {'.'.join(map(str, first['loc']))}: {first['msg']}") from None


def geometry_in_base(name: str, mean: MeanRegion, pose_camera_in_base: F64) -> RegionGeometry:
    """Return the region as it would lie under a camera (4, 4) that stands elsewhere."""
    turn = pose_camera_in_base[:3, :3]
    centre: F64 = turn @ np.array(mean.centre_in_camera) + pose_camera_in_base[:3, 3]
    axis: F64 = turn @ np.array(mean.axis_in_camera)
    axis /= np.linalg.norm(axis)
    lateral = np.array([-axis[1], axis[0], 0.0]) / np.hypot(axis[0], axis[1])
    normal = np.cross(axis, lateral).astype(np.float64)
    return RegionGeometry(
        region=name, centre_m=centre, axis=axis, normal=normal, lateral=lateral,
        radius_m=mean.radius_m, half_length_m=mean.half_length_m, profile_m=np.array(mean.profile_m),
        support_height_m=None if mean.support_under_m is None else float(centre[2]) - mean.support_under_m,
    )  # fmt: skip

"""Whether the skin lay beyond the middle of the robot's tool when the force was largest.

The compiled tissue drops skin that has sunk into a tool beyond the tool's middle. Such a tool is held by nothing until
it meets bone, and what is measured from then on says nothing of a person. The recording keeps the dented skin of that
one moment, so that a tool that went through and came back before is not found.
"""

from __future__ import annotations

import numpy as np

from carecontact.contract.embodiment import robot_of
from carecontact.contract.geometry import matrix_from_quat
from carecontact.contract.rays import Triangles
from carecontact.recording.schema import Recording

BEHIND_M = 0.1
"""How far behind the tool's middle skin is looked for."""
NEEDED = ("report/skin_in_world", "report/skin_faces", "report/peak_time_s")


def passed_the_middle(recording: Recording) -> float | None:
    """Return ``skin_in_tool`` of a recording where it is more than 1; None for any other."""
    found = skin_in_tool(recording)
    return found if found is not None and found > 1 else None


def skin_in_tool(recording: Recording) -> float | None:
    """Return how far the skin lies inside the tool at the largest force, over half of the tool's thickness. Above 1, it
    lies beyond the tool's middle; below 0, outside.

    None if the recording does not have the dented skin, is of a robot that this release does not have, or if no skin of
    the region lies on the tool's axis.
    """
    robot = robot_of(recording.header.embodiment)
    if robot is None or any(name not in recording for name in NEEDED) or not len(recording["scorer/time_s"]):
        return None
    tip, at = robot.tip, int(np.searchsorted(recording["scorer/time_s"], float(recording["report/peak_time_s"][0])))
    pose = recording["scorer/pose_tcp_in_world"][min(at, len(recording["scorer/time_s"]) - 1)].astype(np.float64)
    out = matrix_from_quat(pose[3:])[:, 2]
    middle = pose[:3] - tip.half_m[2] * out
    skin = recording["report/skin_in_world"].astype(np.float64)
    surface = Triangles(skin[recording["report/skin_faces"]])
    ahead = float(surface.distances(middle - BEHIND_M * out, out[None])[0]) - BEHIND_M
    return None if np.isinf(ahead) else 1.0 - ahead / tip.half_m[2]

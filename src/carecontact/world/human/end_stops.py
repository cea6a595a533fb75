"""How a joint resists at the end of its range: a torque that begins there at zero and grows with the cube of the angle.

Engin and Chen 1987, J Biomech Eng 109:318, gave the passive torque of ten elbows beyond their range as a cubic in the
angle (their coefficients were not read; the form is that of a public database's entry on the paper). Riener and Edrich
1999, J Biomech 32:539, use exponentials, which rise in a similar way. The strength of the stop is our choice: a limp
arm that an examiner's pull swings into its end (``validation.passive_response``) goes at most 5 degrees past it, which
is the accuracy with which ranges of motion are read. Real ends are softer and begin earlier.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import mujoco
import numpy as np

if TYPE_CHECKING:
    from carecontact.world.human.body import Array
    from carecontact.world.human.joints import Hinge

REACHED_RAD = float(np.radians(5.0))
PULL_NM = {
    "upper_arm": 85.0, "forearm_flexion": 18.0, "forearm_supination": 3.0, "hand": 2.3, "neck": 6.0, "thigh": 30.0,
    "shank": 15.0, "foot": 10.0, "abdomen": 60.0, "thorax": 60.0,
}  # fmt: skip
"""Part, or part and motion -> torque [N m] at REACHED_RAD past the range; our choice. The values of upper arm and hand
keep limp arms of all nine bodies within this angle: the arms of the lightest women and the hands of the heaviest men
swing the farthest."""


def stop_name(hinge: str) -> str:
    """Return the name of the tendon that is a hinge's end stop."""
    return f"human_stop_{hinge}"


def cubic_nm_rad3(hinge: str) -> float:
    """Return the coefficient [N m/rad^3] of a hinge's end stop, by the hinge's name with or without the side."""
    kind = hinge.removeprefix("left_").removeprefix("right_")
    return next(pull for part, pull in PULL_NM.items() if kind.startswith(part)) / REACHED_RAD**3


def add_end_stop(spec: mujoco.MjSpec, hinge: Hinge) -> None:
    """Add a tendon over the hinge that has no effect inside the hinge's range.

    MuJoCo's own joint limits would not do: their resistance depends on the inertia of what moves, and they have a
    damper that no human joint has.
    """
    stop = spec.add_tendon(
        name=stop_name(hinge.name), springlength=np.radians(hinge.range_deg),
        stiffness=[0.0, 0.0, cubic_nm_rad3(hinge.name)],
    )  # fmt: skip
    stop.wrap_joint(f"human_{hinge.name}", 1.0)


def past_range(angle_rad: Array, low_rad: Array, high_rad: Array) -> Array:
    """Return how far [rad] angles are past the range: positive past the upper end, negative past the lower one, else
    zero.
    """
    return np.maximum(angle_rad - high_rad, 0.0) + np.minimum(angle_rad - low_rad, 0.0)


def end_stop_nm(past_rad: Array, cubic: Array) -> Array:
    """Return the torque [N m] of end stops, which acts against the angle by which each joint is past its range."""
    return -cubic * past_rad**3

"""Where scripted contacts aim."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import griddata

from carecontact.validation.moves import skin_points, surface_point
from carecontact.validation.subject import Subject


@pytest.mark.parametrize("offset", [0.0, 0.03])
def test_surface_point_lies_on_the_skin_under_it(subject: Subject, offset: float) -> None:
    """Not on the highest vertex near it, which on a sloping arm is another on every mesh."""
    simulation = subject.at_rest("forearm")
    point = surface_point(simulation, "forearm", (offset, 0.0))
    skin = skin_points(simulation, "forearm")
    near = skin[(np.linalg.norm(skin[:, :2] - point[:2], axis=1) < 0.02) & (skin[:, 2] > point[2] - 0.03)]
    height = float(griddata(near[:, :2], near[:, 2], point[:2])[0])
    assert point[2] == pytest.approx(height, abs=3e-4)
    assert point[2] < near[np.linalg.norm(near[:, :2] - point[:2], axis=1) < 0.015][:, 2].max() - 3e-4

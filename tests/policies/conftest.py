from __future__ import annotations

from collections.abc import Callable

import pytest

from carecontact.interface.observation import Observation
from carecontact.interface.robot import ActionBounds, Session
from tests.interface.lying_person import HEIGHT, WIDTH, Person, observe


@pytest.fixture(scope="session")
def person() -> Person:
    return Person()


@pytest.fixture(scope="session")
def observation(person: Person) -> Observation:
    return observe(person)


@pytest.fixture
def session() -> Callable[..., Session]:
    def make(low: tuple[float, float, float] = (-0.2, -1.1, -0.15)) -> Session:
        bounds = ActionBounds(
            workspace_low_m=low,
            workspace_high_m=(0.85, 0.75, 0.9),
            translational_stiffness=(100.0, 1000.0),
            rotational_stiffness=(5.0, 50.0),
        )
        return Session(
            action_bounds=bounds,
            joint_low_rad=(-3.0,) * 7,
            joint_high_rad=(3.0,) * 7,
            camera_sizes_px={"overhead": (WIDTH, HEIGHT)},
            time_limit_s=30.0,
        )

    return make

"""Plates: the segment keeps its mass, and each plate swings as slowly as the fast mode can follow."""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np
import pytest

from carecontact.protocols import FAST_DT_S
from carecontact.world.human.anthropometry import SegmentInertia
from carecontact.world.human.plates import GIVES, plate_body, plates, plates_of, without_plates
from carecontact.world.human.skeleton import body_name
from carecontact.world.scene import Scene


@pytest.mark.parametrize("part", sorted(GIVES))
def test_a_plate_is_stable_in_the_fast_mode(part: str) -> None:
    """Semi-implicit Euler with implicit damping holds a spring while (w h)^2 < 4 + 2 h c / m."""
    give = GIVES[part]
    swing = np.sqrt(give.a_n_m / give.mass_kg) * FAST_DT_S
    assert swing**2 < 0.8 * (4 + 2 * FAST_DT_S * give.damping_ns_m / give.mass_kg)
    assert give.source


def test_the_chest_is_the_published_curve() -> None:
    """F = 54.9 D + 10.8 D^2 in newtons and centimetres."""
    depth_cm = np.array([0.5, 1.0, 3.0])
    np.testing.assert_allclose(GIVES["chest"].force_n(depth_cm / 100), 54.9 * depth_cm + 10.8 * depth_cm**2)


def test_what_is_left_of_a_bone_makes_up_the_segment_with_its_plates() -> None:
    row = SegmentInertia(mass_kg=9.0, centre_m=np.array([0.1, 0.0, 0.3]), axes=np.eye(3),
                         moments_kgm2=np.array([0.2, 0.25, 0.1]))  # fmt: skip
    places = [(plate, np.array([0.1 * k, -0.05, 0.2])) for k, plate in enumerate(plates_of("thorax"))]
    mass, centre, tensor = without_plates(row, places)
    bodies = [(mass, centre, tensor), *((p.give.mass_kg, at, p.give.mass_kg * 0.05**2 * np.eye(3)) for p, at in places)]
    whole = sum(m for m, _, _ in bodies)
    middle = sum(m * at for m, at, _ in bodies) / whole
    assert whole == pytest.approx(row.mass_kg)
    np.testing.assert_allclose(middle, row.centre_m, atol=1e-12)
    total = sum(t + m * ((at - middle) @ (at - middle) * np.eye(3) - np.outer(at - middle, at - middle))
                for m, at, t in bodies)  # fmt: skip
    np.testing.assert_allclose(total, np.diag(row.moments_kgm2), atol=1e-12)


def test_plates_hang_on_their_segment_and_give_way_inward(scene_of: Callable[..., Scene]) -> None:
    model = scene_of("forearm").model
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    for plate in plates():
        body = model.body(plate_body(plate.name))
        assert model.body(body.parentid[0]).name == body_name(plate.segment)
        assert body.geomnum[0] == 1
        joints = range(body.jntadr[0], body.jntadr[0] + body.jntnum[0])
        assert len(joints) == len(plate.outward) == (2 if plate.name.startswith("right") else 1)
        for joint, outward in zip(joints, plate.outward, strict=True):
            np.testing.assert_allclose(model.jnt_axis[joint], -outward, atol=1e-9)
            assert model.jnt_stiffness[joint] == plate.give.a_n_m
        # Its own weight moves a plate by less than a millimetre.
        assert 9.81 * plate.give.mass_kg / plate.give.a_n_m < 1e-3

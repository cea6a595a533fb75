"""Things that are no foam, in worlds: seen, of no effect on what moves, and not what a threshold on foam finds."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from scipy import ndimage

from carecontact.episode.randomization import settled_world, under_control
from carecontact.interface.robot import CONTROLS
from carecontact.protocol.sections import OTHER_COLOURS
from carecontact.sim.rendering import SceneRenderer
from carecontact.sim.simulation import Simulation
from carecontact.world.draws import clutter_of
from carecontact.world.room import TOWEL
from tests.episode.test_foam import NEAR_PX, pixels_of, place_px
from tests.protocol.foamy import LEVELS

LEVEL, TASK, SEED = LEVELS["L2"], "T3", 1
PLAIN = LEVEL.model_copy(update={"distractors": None})


@cache
def world(*, plain: bool = False) -> Simulation:
    made = settled_world(PLAIN if plain else LEVEL, task_id=TASK, seed=SEED)[0]
    made.refresh()
    return made


def pictures(simulation: Simulation) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Colours, depth and the cell's own depth of the overhead camera, and where the foam is."""
    with SceneRenderer(simulation.model, protocol=simulation.protocol) as renderer:
        colours, depth = renderer.rgb(simulation.data, "overhead"), renderer.depth(simulation.data, "overhead")
        cell = renderer.cell_depth(np.zeros(7), "overhead")
        place = place_px(simulation, renderer, simulation.protocol.task(TASK).region)
    return colours, np.stack([depth, cell]), place


def test_they_change_no_bit_of_what_moves() -> None:
    """Not while the person settles on the bed, which came before, and not while the tool comes down on the arm."""
    states, forces = list[np.ndarray](), list[np.ndarray]()
    for simulation in (world(), world(plain=True)):
        start, site = simulation.integration_state(), simulation.data.site("region_forearm")
        goal = simulation.control.target_in_base.copy()
        goal[:3] = simulation.encoders.in_base(simulation.data, site.xpos, np.eye(3))[:3, 3] + [0.0, 0.0, 0.02]
        simulation.start()
        simulation.set_goal(goal, 4.0)
        samples = simulation.advance(2500)
        states += [start, simulation.integration_state()]
        forces.append(np.concatenate([s.force for s in samples]))
        simulation.put_back(start)
        simulation.refresh()
    assert np.abs(forces[0]).max() > 1.0, "it touches"
    np.testing.assert_array_equal(forces[0], forces[1])
    np.testing.assert_array_equal(states[:2], states[2:])


def test_a_threshold_finds_the_foam_among_them() -> None:
    colours, _, place = pictures(world())
    foam, clutter = world().scene.foam, clutter_of(LEVEL, SEED, "")
    assert foam is not None
    assert clutter is not None
    found = np.argwhere(pixels_of(foam.colour, colours))[:, ::-1]
    assert len(found) > 40
    assert np.linalg.norm(found - place, axis=1).max() < NEAR_PX
    for thing in (clutter.towel_colour, clutter.dressing_colour):
        assert pixels_of(thing, colours).sum() > 25, "it can be seen"


def test_the_largest_spot_of_a_strong_colour_is_no_foam() -> None:
    """A policy that does not know the colours of foam, and takes what is most unlike skin, goes to the towel."""
    colours, _, place = pictures(world())
    strong = np.ptp(colours.astype(int), axis=2) > 140
    blobs, count = ndimage.label(strong)
    sizes = ndimage.sum_labels(strong, blobs, range(1, count + 1))
    middle = np.array(ndimage.center_of_mass(blobs == 1 + int(np.argmax(sizes))))[::-1]
    assert np.linalg.norm(middle - place) > 3 * NEAR_PX


def test_only_the_towel_has_depth_and_the_map_of_the_cell_has_none_of_them() -> None:
    with_them, without = pictures(world())[1], pictures(world(plain=True))[1]
    np.testing.assert_array_equal(with_them[1], without[1])
    other = np.argwhere(with_them[0] != without[0])
    assert 100 < len(other) < 3000
    towel = pixels_of(tuple((255 * world().model.geom(TOWEL).rgba[:3]).round().astype(int)), pictures(world())[0])
    around = ndimage.binary_dilation(towel, iterations=3)
    assert around[other[:, 0], other[:, 1]].all()


def test_tasks_and_levels_share_the_draw_and_seeds_do_not() -> None:
    """And a level without the section has none."""
    assert clutter_of(LEVEL, SEED, "") == clutter_of(LEVELS["L3"], SEED, "")
    assert clutter_of(LEVELS["L1"], SEED, "") is None
    drawn = [clutter_of(LEVEL, seed, "") for seed in range(40)]
    assert {c.segment for c in drawn if c} == {"left_upper_arm", "left_forearm", "left_shank", "right_shank"}
    assert {c.towel_colour for c in drawn if c} == set(OTHER_COLOURS.values())
    assert clutter_of(LEVEL, SEED, "salt") != clutter_of(LEVEL, SEED, "")


@pytest.mark.parametrize("control", ["droid"])
def test_a_joint_control_keeps_them(control: str) -> None:
    driven, _ = under_control(world(), CONTROLS[control])
    np.testing.assert_array_equal(driven.model.geom(TOWEL).pos, world().model.geom(TOWEL).pos)
    np.testing.assert_array_equal(driven.model.tex_data, world().model.tex_data)

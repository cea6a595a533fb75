"""What the declared cells of the target region felt is in every recording."""

from __future__ import annotations

import numpy as np
import pytest

from carecontact.contract.action import Action
from carecontact.contract.geometry import matrix_from_quat
from carecontact.contract.policy import PolicyCard
from carecontact.contract.trial import TrialSpec
from carecontact.episode.cells import SUMS
from carecontact.episode.episode import Episode
from carecontact.protocols import load_protocol
from carecontact.recording import SEGMENTS, Recording

CARD = PolicyCard(name="press", modalities=(), cameras=(), control_hz=10)
FOREARM = SEGMENTS.index("right_forearm")


@pytest.fixture(scope="module")
def press() -> Recording:
    """Down onto the forearm's middle and 30 mm along it."""
    with Episode(TrialSpec(protocol=load_protocol(), task_id="T1", seed=0, policy="press"), card=CARD) as episode:
        first = episode.reset()
        site = episode.simulation.data.site("region_forearm")
        along, outward = site.xmat.reshape(3, 3)[:, 0], np.array([0.0, 0.0, 1.0])
        base = episode.simulation.pose_base_in_world
        for k in range(45):
            height, way = (0.15, 0.0) if k < 25 else (0.02, 0.0 if k < 35 else 0.003 * (k - 34))
            goal = site.xpos + height * outward + way * along
            pose = first.pose_tcp_in_base.copy()
            pose[:3] = matrix_from_quat(base[3:]).T @ (goal - base[:3])
            episode.step(Action(pose_tcp_in_base=pose, done=k == 44), observe=False)
        return episode.finish()


def test_the_sums_over_the_cells_are_those_of_the_whole_region(press: Recording) -> None:
    dt_s = press.header.spec.protocol.physics.dt_s
    normal = press["scorer/normal_force"][:, FOREARM].astype(float)
    assert normal.max() > 1.0
    steps = round(press.header.spec.protocol.physics.target_period_s / dt_s)
    impulse = normal.reshape(-1, steps).sum(1) * dt_s
    np.testing.assert_allclose(press["scorer/cell_press_ns"].sum(1), impulse, rtol=1e-4, atol=1e-6)
    free = normal.reshape(-1, steps).max(1) == 0
    assert free.any()
    for path in SUMS:
        assert press[path].dtype == np.float32
        assert (press[path] >= 0).all()
        assert press[path][free].max() == 0
        assert press[path][~free].max() > 0


def test_the_cells_lie_on_the_region_and_those_under_the_tool_are_pressed(press: Recording) -> None:
    length, _, radius = press["scorer/region_size_m"][press.header.regions.index("forearm")]
    centres, area = press["scorer/cell_in_region"], press["scorer/cell_area_m2"]
    assert np.abs(centres[:, 0]).max() < length / 2
    assert centres[:, 2].max() == pytest.approx(radius, abs=0.015)
    assert 0 < area.min() <= area.max() < 0.020**2
    last = press["scorer/cell_press_ns"][-1]
    pose = press["scorer/region_pose_in_world"][-1, press.header.regions.index("forearm")].astype(float)
    tool = matrix_from_quat(pose[3:]).T @ (press["scorer/pose_tcp_in_world"][-1, :3] - pose[:3])
    assert np.linalg.norm(last @ centres / last.sum() - tool) < 0.012

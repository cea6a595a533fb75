from __future__ import annotations

import numpy as np
import pytest

from carecontact.contract.protocol import Variation
from carecontact.observation.sensor_noise import SensorNoise, structured_light

INTRINSICS = np.array([[433.0, 0, 319.5], [0, 433.0, 239.5], [0, 0, 1]])
ON = Variation(depth_noise="structured-light-v1", encoder_noise_rad=0.003)


def wall(distance_m: float) -> np.ndarray:
    return np.full((480, 640), distance_m, np.float32)


@pytest.mark.parametrize(("distance_m", "sigma_m"), [(1.0, 0.0019), (2.0, 0.0061), (3.0, 0.0140)])
def test_noise_grows_as_published(distance_m: float, sigma_m: float) -> None:
    seen = structured_light(wall(distance_m), INTRINSICS, np.random.default_rng(0))
    step = 2.85e-3 * distance_m**2
    expected = np.hypot(sigma_m, step / np.sqrt(12))
    assert np.std(seen) == pytest.approx(expected, rel=0.1)
    assert abs(np.mean(seen) - distance_m) < 0.25 * step
    assert np.diff(np.unique(seen)).min() == pytest.approx(step, rel=0.1)


def test_edges_and_grazing_surfaces_have_no_depth() -> None:
    depth = wall(2.0)
    depth[:, 320:] = 1.7
    depth[0] = np.nan
    seen = structured_light(depth, INTRINSICS, np.random.default_rng(0))
    assert np.isnan(seen[:, 319:321]).all()
    assert np.isnan(seen[0]).all()
    assert np.isfinite(seen[10:, :310]).all()
    # A floor seen along itself: x = 0.05 (z - 1), 87 deg from its normal.
    u = np.arange(640) - 319.5
    floor = np.tile(np.float32(0.05 / (0.05 - np.clip(u / 433, -1, 0.04))), (480, 1))
    assert np.isnan(structured_light(floor, INTRINSICS, np.random.default_rng(0))[:, 300:330]).mean() > 0.9


def test_same_moment_and_camera_same_noise() -> None:
    noise, again, other = (SensorNoise(ON, key=key, dt_s=0.002) for key in ([1, 2], [1, 2], [1, 3]))

    def depth(source: SensorNoise, camera: str, time_s: float) -> np.ndarray:
        return source.depth(wall(2.0), INTRINSICS, camera=camera, sim_time_s=time_s)

    first = depth(noise, "overhead", 0.5)
    depth(again, "wrist", 0.1)  # what was asked before does not matter
    np.testing.assert_array_equal(depth(again, "overhead", 0.5), first)
    for source, camera, time_s in ((noise, "overhead", 0.502), (noise, "bedside", 0.5), (other, "overhead", 0.5)):
        assert (depth(source, camera, time_s) != first).mean() > 0.3


def test_encoders() -> None:
    noise, angles = SensorNoise(ON, key=[1], dt_s=0.002), np.arange(7.0)
    read = np.array([noise.joint_position(angles, sim_time_s=k * 0.002) - angles for k in range(500)])
    assert read.std() == pytest.approx(0.003, rel=0.05)
    np.testing.assert_array_equal(noise.joint_position(angles, sim_time_s=0.002) - angles, read[1])


def test_off_is_untouched() -> None:
    noise, depth, angles = SensorNoise(Variation(), key=(), dt_s=0.002), wall(2.0), np.arange(7.0)
    assert noise.depth(depth, INTRINSICS, camera="overhead", sim_time_s=0.0) is depth
    assert noise.joint_position(angles, sim_time_s=0.0) is angles
    assert not noise.on_encoders

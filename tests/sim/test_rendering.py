from __future__ import annotations

from collections.abc import Iterator

import mujoco
import numpy as np
import pytest

from carecontact.errors import SceneError
from carecontact.protocol.load import load_protocol
from carecontact.protocol.sections import Camera
from carecontact.sim import rendering
from carecontact.sim.rendering import SceneRenderer

# A floor 2 m under a camera that looks straight down, a "robot" box of 0.2 m on it, a camera on the robot.
LINKS = 7
INERTIAL = '<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>'
ARM = "".join(
    f'<body name="robot_link{i}">{INERTIAL}<joint name="robot_joint{i}" axis="0 0 1"/>' for i in range(1, LINKS + 1)
)
XML = f"""
<mujoco>
  <visual><global offwidth="320" offheight="240"/><map znear="0.01" zfar="20"/></visual>
  <statistic extent="1"/>
  <worldbody>
    <light pos="0 0 3"/>
    <geom name="floor" type="plane" size="50 50 .1" rgba="0 1 0 1"/>
    <camera name="overhead" pos="0 0 2" xyaxes="0 -1 0 1 0 0" fovy="50"/>
    <camera name="exterior" pos="0 0 2" xyaxes="1 0 0 0 0 1" fovy="50"/>
    <body name="robot_base" pos="0.5 0.25 0" quat="0.7071067811865476 0 0 0.7071067811865476">
      {ARM}
        <geom type="box" size=".1 .1 .1" pos="-0.25 0.5 0.1" group="1" rgba="1 0 0 1" mass="1"/>
        <geom type="box" size=".5 .5 .5" group="3" mass="1"/>
        <site name="tcp" pos="0 0 0.3"/>
      {"</body>" * LINKS}
    </body>
  </worldbody>
</mujoco>
"""


MODEL = mujoco.MjModel.from_xml_string(XML)


@pytest.fixture(scope="module")
def data() -> mujoco.MjData:
    made = mujoco.MjData(MODEL)
    mujoco.mj_forward(MODEL, made)
    return made


@pytest.fixture(scope="module")
def renderer() -> Iterator[SceneRenderer]:
    camera = Camera(position_m=(0, 0, 2), look_at_m=(0, 0, 0), up=(1, 0, 0), fovy_deg=50, width=64, height=48)
    other = camera.model_copy(update={"width": 40, "height": 30})
    protocol = load_protocol("bathing-v3").model_copy(update={"cameras": {"overhead": camera, "exterior": other}})
    with SceneRenderer(MODEL, protocol=protocol) as renderer:
        yield renderer


def test_depth_is_the_distance_along_the_axis(renderer: SceneRenderer, data: mujoco.MjData) -> None:
    depth = renderer.depth(data, "overhead")
    assert depth.shape == (48, 64)
    # The box's top is 0.2 m high; it lies at the world's origin, so in the middle of the image.
    assert depth[24, 32] == pytest.approx(1.8, abs=1e-3)
    assert depth[0, 0] == pytest.approx(2.0, abs=1e-3)
    assert depth[47, 63] == pytest.approx(2.0, abs=1e-3)


def test_depth_beyond_range_is_nan(renderer: SceneRenderer, data: mujoco.MjData) -> None:
    depth = renderer.depth(data, "exterior")
    assert depth.shape == (30, 40)
    assert np.isnan(depth[:15]).all()
    assert np.nanmax(depth) <= rendering.DEPTH_RANGE_M
    assert np.isfinite(depth[-1]).all()


def test_colours(renderer: SceneRenderer, data: mujoco.MjData) -> None:
    rgb = renderer.rgb(data, "overhead")
    assert rgb.dtype == np.uint8
    assert rgb[24, 32].argmax() == 0
    assert rgb[2, 2].argmax() == 1


def test_robot_depth_shows_the_robot_alone_at_the_encoder_angles(renderer: SceneRenderer, data: mujoco.MjData) -> None:
    here = renderer.robot_depth(np.zeros(LINKS), "overhead")
    seen = renderer.depth(data, "overhead")
    robot = np.isfinite(here)
    assert robot[24, 32]
    assert not robot[0, 0]
    np.testing.assert_allclose(here[robot], seen[robot], atol=1e-3)
    turned = renderer.robot_depth([np.pi / 2, 0, 0, 0, 0, 0, 0], "overhead")
    assert not np.isfinite(turned[24, 32])
    assert (data.qpos == 0).all()


def test_the_empty_cell_has_neither_robot_nor_person(renderer: SceneRenderer) -> None:
    cell = renderer.cell_depth(np.zeros(LINKS), "overhead")
    np.testing.assert_allclose(cell, 2.0, atol=1e-3)
    cell[:] = 0
    np.testing.assert_allclose(renderer.cell_depth(np.ones(LINKS), "overhead"), 2.0, atol=1e-3)


def test_a_camera_that_stands_sees_the_empty_cell_once(renderer: SceneRenderer) -> None:
    renderer.cell_depth(np.zeros(LINKS), "exterior")
    before = renderer.renders.copy()
    renderer.cell_depth(np.ones(LINKS), "exterior")
    assert renderer.renders == before


def test_truth_without_a_person(renderer: SceneRenderer, data: mujoco.MjData) -> None:
    seen = renderer.truth(data, "overhead")
    assert not seen.human.any()
    np.testing.assert_array_equal(seen.depth, renderer.depth(data, "overhead"))


def test_the_camera_model_projects_a_known_point(renderer: SceneRenderer, data: mujoco.MjData) -> None:
    pose, intrinsics = renderer.pose_camera_in_base(data, "overhead"), renderer.intrinsics("overhead")
    # The world's origin from a base at (0.5, 0.25) that is turned by 90 degrees.
    in_base = np.array([-0.25, 0.5, 0.0])
    in_camera = pose[:3, :3].T @ (in_base - pose[:3, 3])
    np.testing.assert_allclose(in_camera, [0, 0, 2], atol=1e-9)
    np.testing.assert_allclose((intrinsics @ in_camera)[:2] / in_camera[2], [31.5, 23.5])
    assert intrinsics[0, 0] == pytest.approx(24 / np.tan(np.radians(25)))
    # World +x is up in this image, and +y is to the left.
    ahead = pose[:3, :3].T @ np.array([0.0, -1.0, 0.0])
    np.testing.assert_allclose(ahead, [0, -1, 0], atol=1e-9)


def test_renders_are_counted(renderer: SceneRenderer, data: mujoco.MjData) -> None:
    before = renderer.renders.copy()
    renderer.depth(data, "overhead")
    renderer.robot_depth(np.zeros(LINKS), "overhead")
    assert renderer.renders - before == {"depth": 1, "robot_depth": 1}


def test_a_closed_renderer_opens_again(renderer: SceneRenderer, data: mujoco.MjData) -> None:
    first = renderer.rgb(data, "overhead")
    renderer.close()
    np.testing.assert_array_equal(renderer.rgb(data, "overhead"), first)


def test_unknown_camera(renderer: SceneRenderer, data: mujoco.MjData) -> None:
    with pytest.raises(SceneError, match="exterior, overhead"):
        renderer.rgb(data, "ceiling")

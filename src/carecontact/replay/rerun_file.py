"""A recorded trial as a file of Rerun: objects, skin, and the recorded quantities over time."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt

from carecontact.errors import DependencyError
from carecontact.interface.geometry import matrix_from_quat
from carecontact.interface.regions import REGIONS
from carecontact.recording.pictures import Pictures
from carecontact.recording.schema import Recording
from carecontact.replay.panel import heat, story_of
from carecontact.replay.replay import STATE, Replay, ReplayQuality, Stretch
from carecontact.replay.stage import FilmSkin
from carecontact.world.robot import VISUAL_GROUP
from carecontact.world.room import FURNITURE_GROUP, LOOSE_GROUP

HZ = 100.0
"""Rate of the plotted quantities; of each interval the largest sample is kept, so that no peak of force is lost."""


F64 = npt.NDArray[np.float64]


def series_of(recording: Recording) -> Iterator[tuple[str, str, F64, F64]]:
    """Path, label, times [s] and values: force on touched segments, indentation, margins of joints, speed and lag of
    the tool."""
    header, arrays = recording.header, recording.arrays
    stride = max(1, round(1 / (HZ * header.spec.protocol.physics.dt_s)))
    time_s, period_s = arrays["scorer/time_s"], arrays["scorer/period_time_s"]
    force = np.linalg.norm(arrays["scorer/force_human_from_robot_in_world"], axis=2)
    target = REGIONS[header.spec.protocol.task(header.spec.task_id).region].segment
    for column, segment in enumerate(header.segments):
        if segment == target or force[:, column].any():
            yield f"force/{segment}", f"{segment} [N]", time_s[::stride], _largest(force[:, column], stride)
    for column, region in enumerate(header.regions):
        depth = 1000.0 * arrays["scorer/indentation_m"][:, column]
        yield f"indentation/{region}", f"{region} [mm]", period_s, depth
    low, high = arrays["scorer/human_joint_range"].T
    angle = arrays["scorer/human_joint_position"][::stride].astype(np.float64)
    margin = np.degrees(np.minimum(angle - low, high - angle))
    for column, joint in enumerate(header.human_joints):
        yield f"joint_margin/{joint}", f"{joint} [deg]", time_s[::stride], margin[:, column]
    yield "tool/speed", "speed [mm/s]", time_s[::stride], 1000.0 * _largest(arrays["scorer/tcp_speed"], stride)
    base = np.array(header.pose_base_in_world)
    commanded = arrays["scorer/target_in_base"][:, :3] @ matrix_from_quat(base[3:]).T + base[:3]
    step = np.clip(np.searchsorted(time_s, period_s), 0, len(time_s) - 1)
    off = np.linalg.norm(arrays["scorer/pose_tcp_in_world"][step, :3] - commanded, axis=1)
    yield "tool/from_command", "from command [mm]", period_s, 1000.0 * off


def _largest(values: npt.NDArray[Any], stride: int) -> F64:
    return np.array([values[k : k + stride].max() for k in range(0, len(values), stride)], np.float64)


STILL_M = 3e-4
"""A part of the skin is sent again once one of its vertices has moved this far since it was sent last."""


def solids(model: mujoco.MjModel, rerun: Any) -> Iterator[tuple[str, str, Any]]:
    """Name, body and Rerun's archetype of each geom of the robot, of the furniture and of what lies about, in the frame
    of its body."""
    for geom in range(model.ngeom):
        if model.geom_group[geom] not in (VISUAL_GROUP, FURNITURE_GROUP, LOOSE_GROUP) or model.geom_rgba[geom, 3] == 0:
            continue
        made = _archetype(model, geom, rerun)
        if made is not None:
            yield model.geom(geom).name or f"geom{geom}", model.body(model.geom_bodyid[geom]).name, made


def _archetype(model: mujoco.MjModel, geom: int, rerun: Any) -> Any:
    kind, size, kinds = model.geom_type[geom], model.geom_size[geom], mujoco.mjtGeom
    position, quat = model.geom_pos[geom], np.roll(model.geom_quat[geom], -1)
    colour = np.round(255 * model.geom_rgba[geom]).astype(np.uint8)
    if kind == kinds.mjGEOM_MESH:
        mesh = model.mesh(model.geom_dataid[geom])
        vertex, count = int(mesh.vertadr[0]), int(mesh.vertnum[0])
        face = int(mesh.faceadr[0])
        vertices = model.mesh_vert[vertex : vertex + count] @ matrix_from_quat(model.geom_quat[geom]).T + position
        faces = model.mesh_face[face : face + int(mesh.facenum[0])]
        return rerun.Mesh3D(
            vertex_positions=vertices,
            triangle_indices=faces,
            vertex_normals=mesh_normals(vertices, faces),
            albedo_factor=colour,
        )
    at = {"centers": [position], "quaternions": [rerun.Quaternion(xyzw=quat)], "colors": [colour], "fill_mode": "solid"}
    if kind == kinds.mjGEOM_BOX:
        return rerun.Boxes3D(half_sizes=[size], **at)
    if kind == kinds.mjGEOM_ELLIPSOID:
        return rerun.Ellipsoids3D(half_sizes=[size], **at)
    if kind == kinds.mjGEOM_CYLINDER:
        return rerun.Cylinders3D(lengths=[2 * size[1]], radii=[size[0]], **at)
    return None


def mesh_normals(vertices: F64, faces: npt.NDArray[np.integer]) -> npt.NDArray[np.float32]:
    """(V, 3) area-weighted normals."""
    corner = vertices[faces]
    face = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    total = np.zeros_like(vertices)
    for k in range(3):
        np.add.at(total, faces[:, k], face)
    return (total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-12)).astype(np.float32)


def skin_colours(model: mujoco.MjModel) -> npt.NDArray[np.uint8]:
    """(V, 3) of the skin's texture at its vertices."""
    texture = model.texture("human_skin")
    width, height, start = int(texture.width[0]), int(texture.height[0]), int(texture.adr[0])
    image = np.asarray(model.tex_data[start : start + 3 * width * height]).reshape(height, width, 3)
    place = np.asarray(model.skin_texcoord).reshape(-1, 2)[: model.nskinvert]
    column = np.clip((place[:, 0] * width).astype(int), 0, width - 1)
    row = np.clip((place[:, 1] * height).astype(int), 0, height - 1)
    return image[row, column]


@dataclass(kw_only=True)
class SkinPart:
    """Some triangles of the skin, which are sent when they have moved."""

    path: str
    vertices: npt.NDArray[np.int64]
    """(n,) of the skin"""
    faces: npt.NDArray[np.int64]
    """(m, 3) of ``vertices``"""
    colours: npt.NDArray[np.uint8]
    """(n, 3)"""
    sent: F64 | None = None

    def changed(self, rerun: Any, vertices: F64, normals: F64) -> Iterator[Any]:
        """The mesh, whole the first time and later without what stays; nothing while it is still."""
        mine = vertices[self.vertices]
        if self.sent is not None and np.abs(mine - self.sent).max() < STILL_M:
            return
        moved = {
            "vertex_positions": mine.astype(np.float32),
            "vertex_normals": normals[self.vertices].astype(np.float32),
        }
        if self.sent is None:
            yield rerun.Mesh3D(**moved, triangle_indices=self.faces, vertex_colors=self.colours)
        else:
            yield rerun.Mesh3D.from_fields(**moved)
        self.sent = mine


def skin_parts(skin: FilmSkin, colours: npt.NDArray[np.uint8]) -> list[SkinPart]:
    """Return the skin in two kinds of parts: those over soft tissue, which can be dented, and the rest."""
    dented = skin.dentable[skin.faces].any(1)
    parts = []
    for name, faces in (("dented", skin.faces[dented]), ("rest", skin.faces[~dented])):
        if len(faces):
            vertices, index = np.unique(faces, return_inverse=True)
            path = f"world/person/skin/{name}"
            parts.append(SkinPart(path=path, vertices=vertices, faces=index.reshape(-1, 3), colours=colours[vertices]))
    return parts


TIMELINE = "trial"
ARROW_M_N = 0.01
"""Length of the force's arrow."""
CLOUD_STRIDE = 3
"""Every third pixel each way becomes a point of the cloud."""


def rerun_sdk() -> Any:
    """Raises DependencyError where the extra is not installed."""
    try:
        return import_module("rerun")
    except ModuleNotFoundError:
        raise DependencyError("a view in Rerun needs its SDK: pip install 'carecontact[viz]'") from None


def save(recording: Recording, path: Path, *, fps: float) -> ReplayQuality:
    """Write the file as a whole or not at all. Raises RecordingError, and DependencyError without Rerun's SDK."""
    rerun = rerun_sdk()
    part = path.with_name(f"{path.name}.part")
    try:
        stream = rerun.RecordingStream("carecontact", recording_id=None, send_properties=False)
        stream.save(str(part), default_blueprint=blueprint(recording))
        found = _Writer(rerun, stream, recording).write(fps)
        stream.flush()
        stream.disconnect()
        os.replace(part, path)
    finally:
        part.unlink(missing_ok=True)
    return found


def blueprint(recording: Recording) -> Any:
    """Return the world beside force, pressure, cameras and joints."""
    rrb: Any = import_module("rerun.blueprint")
    cameras = sorted({camera for _, camera, _ in Pictures(recording)})
    plots = [
        rrb.TimeSeriesView(origin="/force", name="Force on the person [N]"),
        rrb.TimeSeriesView(origin="/indentation", name="Indentation [mm]"),
        rrb.Tabs(
            rrb.TimeSeriesView(origin="/joint_margin", name="Margin to the joints' limits [deg]"),
            rrb.TimeSeriesView(origin="/tool", name="Tool"),
            rrb.TextLogView(origin="/events", name="Events"),
        ),
    ]
    seen = [rrb.Spatial2DView(origin=f"/world/cameras/{name}", name=f"Policy: {name}") for name in cameras]
    left = rrb.Vertical(
        rrb.Spatial3DView(origin="/world", name="World"),
        *([rrb.Horizontal(*seen)] if seen else []),
        row_shares=[3, 1] if seen else [1],
    )
    return rrb.Blueprint(
        rrb.Horizontal(left, rrb.Vertical(*plots), column_shares=[3, 2]),
        rrb.TimePanel(timeline=TIMELINE, state="collapsed"),
        collapse_panels=True,
    )


class _Writer:
    def __init__(self, rerun: Any, stream: Any, recording: Recording) -> None:
        self._rr, self._stream, self._recording = rerun, stream, recording
        spec = recording.header.spec
        self._replay = Replay(recording)
        region = spec.protocol.task(spec.task_id).region
        self._model = self._replay.model
        self._data, self._skin = mujoco.MjData(self._model), FilmSkin(self._replay.scene)
        self._parts = skin_parts(self._skin, skin_colours(self._model))
        self._region, self._story = region, story_of(recording)

    def write(self, fps: float) -> ReplayQuality:
        self._constants()
        found = ReplayQuality()
        for stretch in self._replay.stretches(fps):
            found.take(stretch)
            self._stretch(stretch)
        self._looks()
        self._plots()
        return found

    def _log(self, path: str, what: Any, *, static: bool = False) -> None:
        self._stream.log(path, what, static=static)

    def _at(self, time_s: float) -> None:
        self._stream.set_time(TIMELINE, duration=time_s)

    def _constants(self) -> None:
        rr = self._rr
        self._log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        self._paths: dict[str, str] = {}
        robot = self._model.body(self._replay.scene.robot.base_body).id
        for name, body, archetype in solids(self._model, rr):
            parent = "world/room"
            if body != "world":
                parent = f"world/{'robot' if self._model.body(body).rootid[0] == robot else 'room'}/{body}"
                self._paths[parent] = body
            self._log(f"{parent}/{name}", archetype, static=True)
        path = self._recording["scorer/pose_tcp_in_world"][::10, :3]
        self._log("world/tcp_path", rr.LineStrips3D([path], colors=[[40, 110, 160]], radii=[0.0008]), static=True)
        for name, camera in self._recording.header.spec.protocol.cameras.items():
            lens = rr.Pinhole(
                focal_length=self._focal_px(name),
                width=camera.width,
                height=camera.height,
                camera_xyz=rr.ViewCoordinates.RDF,
                image_plane_distance=0.12,
            )
            self._log(f"world/cameras/{name}", lens, static=True)

    def _focal_px(self, name: Any) -> float:
        camera = self._recording.header.spec.protocol.cameras[name]
        return float(0.5 * camera.height / np.tan(0.5 * np.radians(camera.fovy_deg)))

    def _stretch(self, stretch: Stretch) -> None:
        for step, state in zip(stretch.steps, stretch.states, strict=True):
            mujoco.mj_setState(self._model, self._data, state, STATE)
            mujoco.mj_kinematics(self._model, self._data)
            mujoco.mj_camlight(self._model, self._data)
            self._at(float(step) * self._replay.dt_s)
            self._frame(int(step))

    def _frame(self, step: int) -> None:
        rr, data, model = self._rr, self._data, self._model
        for path, body in self._paths.items():
            at = data.body(body)
            self._log(path, rr.Transform3D(translation=at.xpos, quaternion=rr.Quaternion(xyzw=np.roll(at.xquat, -1))))
        for camera in self._recording.header.spec.protocol.cameras:
            at = data.cam(str(camera))
            turn = at.xmat.reshape(3, 3) @ np.diag([1.0, -1.0, -1.0])
            self._log(f"world/cameras/{camera}", rr.Transform3D(translation=at.xpos, mat3x3=turn))
        tcp = data.site_xpos[model.site(self._replay.scene.robot.tcp_site).id]
        self._log("world/tcp", rr.Points3D([tcp], colors=[[40, 110, 160]], radii=[0.004]))
        self._send_contact(step)
        vertices, normals = self._skin.placed(data)
        for part in self._parts:
            for mesh in part.changed(self._rr, vertices, normals):
                self._log(part.path, mesh)

    def _send_contact(self, step: int) -> None:
        rr, arrays = self._rr, self._recording.arrays
        row = min(step, len(arrays["scorer/time_s"]) - 1)
        force, place = arrays["scorer/force_human_from_robot_in_world"][row], arrays["scorer/centroid_in_world"][row]
        on = np.linalg.norm(force, axis=1) > 0.01
        # The arrow ends where the tool presses.
        vectors = ARROW_M_N * force[on]
        self._log(
            "world/force",
            rr.Arrows3D(vectors=vectors, origins=place[on] - vectors, colors=[[200, 50, 30]], radii=[0.002]),
        )
        if self._story.map is None:
            return
        header = self._recording.header
        pose = arrays["scorer/region_pose_in_world"][row, header.regions.index(self._region)].astype(np.float64)
        cells = arrays["scorer/cell_in_region"] @ matrix_from_quat(pose[3:]).T + pose[:3]
        pressure, _ = self._story.map.at(row * self._replay.dt_s)
        pressed = pressure > 0.05
        top = max(float(self._story.map.pressure_kpa.max()), 1.0)
        self._log("world/pressure", rr.Points3D(cells[pressed], colors=heat(pressure[pressed] / top), radii=[0.003]))

    def _looks(self) -> None:
        """What the policy was sent: its images, and the point cloud that its depth image gives."""
        rr, arrays = self._rr, self._recording.arrays
        times = arrays["policy/observation_time_s"]
        rgb: dict[str, Any] = {}
        """Camera -> its last picture; that of a depth image comes before it."""
        for (index, camera, kind), picture in Pictures(self._recording).items():
            time_s = float(times[index]) if index < len(times) else float(arrays["scorer/time_s"][-1])
            self._at(time_s)
            if kind == "rgb":
                rgb[camera] = picture
                self._log(f"world/cameras/{camera}/rgb", rr.Image(picture).compress(jpeg_quality=90))
                continue
            self._log(f"world/cameras/{camera}/depth", rr.DepthImage(np.nan_to_num(picture), meter=1.0))
            points, colours = self._cloud(picture, rgb.get(camera), camera)
            self._log(f"world/cloud/{camera}", rr.Points3D(points, colors=colours, radii=[0.0025]))

    def _cloud(self, depth: Any, rgb: Any, name: str) -> tuple[F64, Any]:
        """Return a depth image's points in the world, and colours, for the camera's pose in the last state shown."""
        focal = self._focal_px(name)
        rows, columns = (a.ravel() for a in np.mgrid[: depth.shape[0] : CLOUD_STRIDE, : depth.shape[1] : CLOUD_STRIDE])
        z = depth[rows, columns].astype(np.float64)
        there = np.isfinite(z)
        rows, columns, z = rows[there], columns[there], z[there]
        middle = (np.array(depth.shape) - 1) / 2
        local = np.stack([(columns - middle[1]) / focal * z, -(rows - middle[0]) / focal * z, -z], 1)
        at = self._data.cam(name)
        colours = np.full((len(z), 3), 150, np.uint8) if rgb is None else rgb[rows, columns]
        return local @ at.xmat.reshape(3, 3).T + at.xpos, colours

    def _plots(self) -> None:
        rr = self._rr
        for path, label, time_s, values in series_of(self._recording):
            self._log(path, rr.SeriesLines(names=[label]), static=True)
            column = rr.TimeColumn(TIMELINE, duration=time_s)
            self._stream.send_columns(path, indexes=[column], columns=rr.Scalars.columns(scalars=values))
        gate = self._story.trace.gate_n
        self._at(0.0)
        self._log("events", rr.TextLog(f"force limit of the {REGIONS[self._region].segment}: {gate:g} N"))
        for event in self._story.events:
            self._at(event.time_s)
            self._log("events", rr.TextLog(event.text))

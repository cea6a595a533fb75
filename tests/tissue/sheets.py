"""A flat square sheet of tissue on a fixed bone, and a tool on slides above it: small worlds with closed forms."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt

from carecontact.protocol.person import Tissue
from carecontact.tissue.plugin import LOCK, Mesh, Readings, add_region

Array = npt.NDArray[np.float64]
HEAVY_KG = 1e6
"""A tool of this mass follows its prescribed motion, whatever pushes it."""


def tissue(**fields: float) -> Tissue:
    values = {"a_n_m3": 1e6, "b_n_m4": 0.0, "c_n_m5": 0.0, "damping_ns_m3": 1e4, "coupling_length_m": 0.0}
    values |= {"membrane_n_m": 0.0, "contact_n_m3": 2e8, "areal_mass_kg_m2": 12.0, "friction": 0.5}
    values |= {"spacing_m": 0.005, "coarse_spacing_m": 0.005, "thickness_m": 0.03, "measured_depth_m": 0.01}
    return Tissue(source="made for a test", **values | fields)  # pyright: ignore[reportArgumentType]


def sheet(*, half_m: float = 0.05, spacing_m: float = 0.005) -> Mesh:
    """A square in the plane z = 0 of a triangular lattice, its inward direction down; one cell for every quarter."""
    count = int(half_m / spacing_m)
    rows = int(half_m / (spacing_m * np.sqrt(3) / 2))
    x, y = np.meshgrid(np.arange(-count, count + 1), np.arange(-rows, rows + 1), indexing="ij")
    places = np.stack([(x + 0.5 * (y % 2)) * spacing_m, y * spacing_m * np.sqrt(3) / 2, np.zeros(x.shape)], -1)
    number = np.arange(x.size).reshape(x.shape)
    triangles = []
    for j in range(2 * rows):
        here, there = number[:, j], number[:, j + 1]
        # A shifted row's points stand half a step to the right.
        low, high = (here, there) if y[0, j] % 2 == 0 else (there, here)
        triangles += [(low[i], low[i + 1], high[i]) for i in range(2 * count)]
        triangles += [(low[i + 1], high[i + 1], high[i]) for i in range(2 * count)]
    flat, corners = places.reshape(-1, 3), np.array(triangles)
    edge = flat[corners]
    area = np.linalg.norm(np.cross(edge[:, 1] - edge[:, 0], edge[:, 2] - edge[:, 0]), axis=1) / 2
    middle, areas = edge.mean(1), np.zeros(len(flat))
    np.add.at(areas, corners, area[:, None] / 3)
    cells = 2 * (middle[:, 0] > 0) + (middle[:, 1] > 0).astype(np.int64)
    inward, along = np.tile([0.0, 0.0, -1.0], (len(flat), 1)), np.array([1.0, 0.0, 0.0])
    return Mesh(places=flat, inward=inward, along=along, triangles=corners, areas=areas, cells=cells)


class Sheet:
    """A tool that slides along x and z over a sheet. Its first geom starts with its lowest point at z = 0.

    Args:
        geom: of ``MjsBody.add_geom``.
        bottom_m: distance of the geom's lowest point from its centre.
        give_m3_n: how far the tool's own surface gives way under pressure.
        frame: (3, 3) turns the whole world; nothing may depend on it.
        free: let the tool turn and go anywhere, instead of slide; then ``move`` and ``hold`` do not work.
        vertices: (n, 3) of a mesh named "tool", for a geom of type MESH.
        more: further geoms of the tool, of ``MjsBody.add_geom``, whose ``pos`` is seen from the lowest point.
        layer_m, entry_m, lock: of ``add_region``.
    """

    def __init__(
        self, law: Tissue, mesh: Mesh, *, bottom_m: float, dt_s: float = 0.002, mass_kg: float = HEAVY_KG,
        ledger: bool = False, give_m3_n: float = 0.0, bone_mass_kg: float | None = None, frame: Array | None = None,
        free: bool = False, vertices: Array | None = None, more: tuple[dict[str, Any], ...] = (), layer_m: float = 0.0,
        entry_m: float = 0.0, lock: float = LOCK, **geom: object,
    ) -> None:  # fmt: skip
        spec = mujoco.MjSpec()
        spec.option.timestep, spec.option.gravity = dt_s, [0, 0, 0]
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        quat = np.array([1.0, 0, 0, 0])
        if frame is not None:
            mujoco.mju_mat2Quat(quat, frame.ravel())
        bone = spec.worldbody.add_body(name="bone", quat=quat)
        if bone_mass_kg is not None:
            bone.mass, bone.inertia, bone.explicitinertial = bone_mass_kg, np.full(3, bone_mass_kg * 1e-3), True
            bone.add_freejoint()
        tool = spec.worldbody.add_body(
            name="tool", quat=quat, mass=mass_kg, explicitinertial=True, inertia=[1.0, 1.0, 1.0]
        )
        if free:
            tool.add_freejoint()
        for axis in () if free else ([1, 0, 0], [0, 0, 1]):
            tool.add_joint(type=mujoco.mjtJoint.mjJNT_SLIDE, axis=axis)
        if vertices is not None:
            spec.add_mesh(name="tool", uservert=vertices.ravel().tolist())
        tool.add_geom(name="tool", pos=[0, 0, bottom_m], mass=0, contype=1, conaffinity=0, **geom)
        for other in more:
            tool.add_geom(mass=0, contype=1, conaffinity=0, **other)
        if give_m3_n:
            spec.nuser_geom, tool.first_geom().userdata = 1, [give_m3_n]
        add_region(
            spec,
            name="sheet",
            bone=bone,
            mesh=mesh,
            tissue=law,
            tools="tool",
            ledger=ledger,
            layer_m=layer_m,
            entry_m=entry_m,
            lock=lock,
        )
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        self.felt = Readings(self.model, "sheet")
        self._slides = slice(self.model.nq - 2, self.model.nq)

    def move(self, path: Array) -> npt.NDArray[np.void]:
        """(n,) rows of ``tissue.plugin.ROW`` while the tool is at (n, 2) places x, z [m], one in each step."""
        rows = []
        before = path[0]
        for place in path:
            self.data.qpos[self._slides] = place
            self.data.qvel[-2:] = (place - before) / self.model.opt.timestep
            mujoco.mj_step(self.model, self.data)
            rows.append(self.felt.last(self.data, 1)[0])
            before = place
        return np.array(rows)

    def hold(self, depth_m: float, *, x_m: float = 0.0, steps: int = 600) -> np.void:
        """The row after the tool was lowered to a depth and held there."""
        down = np.linspace(0.0005, -depth_m, 200)
        path = np.concatenate([down, np.full(steps, -depth_m)])
        return self.move(np.stack([np.full(len(path), x_m), path], 1))[-1]


SPHERE = mujoco.mjtGeom.mjGEOM_SPHERE
CYLINDER = mujoco.mjtGeom.mjGEOM_CYLINDER
BOX = mujoco.mjtGeom.mjGEOM_BOX
CAPSULE = mujoco.mjtGeom.mjGEOM_CAPSULE
ELLIPSOID = mujoco.mjtGeom.mjGEOM_ELLIPSOID
MESH = mujoco.mjtGeom.mjGEOM_MESH


def corners_of_a_box(*half_m: float) -> Array:
    """(8, 3)"""
    return np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * half_m


def corners_of_a_prism(sides: int, radius_m: float, half_m: float) -> Array:
    """(2 sides, 3) of a prism that lies along y on one of its sides."""
    angle = 2 * np.pi * (np.arange(sides) + 0.5) / sides
    round_m = radius_m * np.stack([np.sin(angle), np.zeros(sides), -np.cos(angle)], 1)
    return np.concatenate([round_m + [0, y, 0] for y in (-half_m, half_m)])


def model_xml(law: Tissue, mesh: Mesh, *, vertices: Array | None = None) -> str:
    """A body of 0.1 kg that falls onto a sheet from 1 mm above it, as MJCF: a ball of 20 mm or the hull of (n, 3)
    vertices."""
    made = Sheet(law, mesh, bottom_m=0.02, type=SPHERE, size=[0.02, 0, 0]).model
    numerics = "".join(
        f'<numeric name="{made.numeric(k).name}" size="{made.numeric(k).data.size}" '
        f'data="{" ".join(repr(float(x)) for x in made.numeric(k).data)}"/>'
        for k in range(made.nnumeric)
    )
    counts = {"vertices": 13, "edges": 3, "triangles": 5}
    config = "".join(
        f'<config key="{kind}" value="{made.numeric(f"sheet/{kind}").data.size // columns}"/>'
        for kind, columns in counts.items()
    )
    asset, shape = "", 'size="0.02"'
    if vertices is not None:
        asset = f'<asset><mesh name="tool" vertex="{" ".join(map(str, vertices.ravel().tolist()))}"/></asset>'
        shape = 'type="mesh" mesh="tool"'
    return f"""
<mujoco>
  <extension><plugin plugin="carecontact.tissue"><instance name="sheet">
    <config key="key" value="sheet"/><config key="tools" value="ball"/>
    <config key="cells" value="{mesh.cells.max(initial=-1) + 1}"/>
    {config}
  </instance></plugin></extension>
  <custom>{numerics}</custom>
  {asset}
  <worldbody>
    <body name="bone"><plugin instance="sheet"/></body>
    <body name="ball" pos="0 0 0.021"><freejoint/><geom {shape} mass="0.1" conaffinity="0"/></body>
  </worldbody>
</mujoco>
"""

"""A soft region in the model: thickness and stiffness of tissue by build and by how people differ, and the shell over a
bone."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import mujoco
import numpy as np
import numpy.typing as npt

from carecontact.human.body import Array, Body
from carecontact.human.shell import Shell
from carecontact.human.skeleton import add_hull, body_name
from carecontact.interface.regions import REGIONS, Tube
from carecontact.protocol.person import Tissue
from carecontact.tissue.plugin import LOCK, Mesh, add_region

# A row of tissue names the body mass index of its person. For another body, the tissue is thicker or thinner according
# to ultrasound and weight gain, and its law is weaker or stronger according to finite elements of that thickness. The
# modulus is unchanged: no publication was found on how it depends on build.

LEAST_BMI, MOST_BMI = 18.5, 40.0
"""Range [kg/m^2] in which thickness depends on the body mass index; outside, it stays at the nearer end's (assumed)."""


@dataclass(frozen=True, kw_only=True)
class Growth:
    """The effect of one more kg/m^2 on a region."""

    thickness_m: float
    """Thickness gained for each kg/m^2."""
    weakening: float
    """Force falls with thickness to this power. It comes from finite elements with the middle skin
    (``lab.fem``): force at 4 mm past touch of the region's reference indenter, thickness at a BMI of 32 against
    man-adult's."""
    source: str


_ARM_FAT = (
    "fat behind the upper arm of 3.7 mm below a BMI of 25 and 5.1 mm above 30 (Cotofana et al. 2020), taken as "
    "10 kg/m2 apart (assumed)"
)
GROWTH = {
    "forearm": Growth(thickness_m=0.00014, weakening=1.02, source=f"as on the upper arm (assumed): {_ARM_FAT}"),
    "upper_arm": Growth(thickness_m=0.00014, weakening=0.60, source=_ARM_FAT),
    "abdomen": Growth(
        thickness_m=0.0012,
        weakening=0.16,
        source="20 kg more add 2 to 14 mm to the trunk's soft tissue: their middle, at man-adult's stature",
    ),
}
"""Region -> its growth. Any other region has the thickness and the law of its row on every body."""


def tissue_of(body: Body, region: str, row: Tissue) -> Tissue:
    """Return the tissue of a region on a body: the row itself if it is for this build or names none.

    The thickness changes and scales the law by one factor at every depth, so that it stays convex. The damping keeps
    its ratio to critical damping. The depth to which the law was measured is unchanged.
    """
    # Rows of tissue name the index rounded to a tenth.
    if row.bmi_kg_m2 is None or region not in GROWTH or row.bmi_kg_m2 == (bmi := round(body.bmi, 1)):
        return row
    growth = GROWTH[region]
    own, theirs = (float(np.clip(value, LEAST_BMI, MOST_BMI)) for value in (bmi, row.bmi_kg_m2))
    thickness_m = max(row.thickness_m + growth.thickness_m * (own - theirs), row.measured_depth_m)
    factor = float((thickness_m / row.thickness_m) ** -growth.weakening)
    return stiffened(row, factor).model_copy(update={"thickness_m": thickness_m, "bmi_kg_m2": bmi})


def stiffened(row: Tissue, factor: float) -> Tissue:
    """Return a row whose law is ``factor`` times as strong at every depth and whose damping ratio is the same."""
    rooted = ("damping_ns_m3", "damping_growth_ns_m4")
    changed = {name: factor * getattr(row, name) for name in ("a_n_m3", "b_n_m4", "c_n_m5")}
    return row.model_copy(update={**changed, **{name: factor**0.5 * getattr(row, name) for name in rooted}})


P95 = 1.6448536269514722
"""The 95th percentile of the standard normal distribution."""
WIDEST = 2.0
"""Largest deviate [standard deviations]: draws beyond it are set to it, since no publication says how far the tails
reach."""


@dataclass(frozen=True, kw_only=True)
class Spread:
    """Distribution over people of the factor of a law; its median is 1."""

    p5: float
    p95: float
    together: str
    """Regions with the same word share one draw: a person with a soft forearm has a soft upper arm (assumed)."""
    source: str

    def factor(self, deviate: float) -> float:
        """Return the factor at a standard normal deviate.

        Its logarithm is normal with different widths below and above the median, so that the 5th, 50th and 95th
        percentile are the published ones.
        """
        z = float(np.clip(deviate, -WIDEST, WIDEST))
        return float((self.p95 if z > 0 else 1 / self.p5) ** (z / P95))


_MULTIS = "secant stiffness, 91-95 adults: MULTIS (Neumann et al. 2018, Sci Data 5:180193; 2019, J Biomech 95:109307)"
SPREADS = {
    "forearm": Spread(p5=0.7445 / 1.1903, p95=2.1519 / 1.1903, together="arm", source=f"{_MULTIS}, anterior forearm"),
    "upper_arm": Spread(
        p5=0.4341 / 0.6445, p95=1.4601 / 0.6445, together="arm", source=f"{_MULTIS}, anterior upper arm"
    ),
    "abdomen": Spread(
        p5=6.4795 / 7.9611,
        p95=9.3256 / 7.9611,
        together="trunk",
        source="force at 22 mm of ten men, mean of sites R1-R5: Remus et al. 2024, Front Bioeng Biotechnol 12:1384062, "
        "supplement S1",
    ),
}
"""Region -> its spread. The tissue of any other region is not varied."""


def draw_tissue(rng: np.random.Generator, rows: Mapping[str, Tissue]) -> dict[str, Tissue]:
    """Draw one person's tissue: the rows of the regions in SPREADS, each made softer or stiffer by a drawn factor."""
    words = sorted({spread.together for spread in SPREADS.values()})
    deviates = dict(zip(words, rng.standard_normal(len(words)).tolist(), strict=True))
    return {
        region: stiffened(row, spread.factor(deviates[spread.together]))
        for region, row in rows.items()
        if (spread := SPREADS.get(region)) is not None
    }


# The shell is no part of MuJoCo's degrees of freedom. Each of its vertices has three displacements: along its inward
# normal, which the anchor law of the paper's Eq. 3 resists, f_c = K_c phi + D_c dphi/dt, and along two tangents. The
# force between neighbours (f_int of Eq. 1) is the discrete Laplacian of the indentation if ``Tissue.coupling_length_m``
# is not 0, and that of the tangential displacement if ``Tissue.membrane_n_m`` is not 0. The package
# ``carecontact.tissue`` solves them in every physics step and pushes bone and tool with equal and opposite forces.

CORE_MIN_RADIUS_M = 0.006
CORE_PIECE_M, CORE_SECTOR_RAD = 0.030, np.pi / 3
CELL_M = 0.0075
"""Side of a declared cell, for which pressure, shear and slip are recorded: half the width of the tool's tip. A round
tip that passes over part of a cell wipes more of it than it touches at any moment. By geometry, a disc of 9 mm radius
loses a tenth of its strip on cells of 15 mm, and a thirtieth on these."""


@dataclass(frozen=True, kw_only=True)
class SoftRegion:
    name: str
    shell: Shell
    tissue: Tissue
    cells: DeclaredCells


@dataclass(frozen=True, kw_only=True)
class DeclaredCells:
    """Patches of the fine part of a shell, of about CELL_M along the region and across it."""

    of_triangle: npt.NDArray[np.int64]
    """(M,) number of the cell of each of the shell's triangles; -1 outside the fine part"""
    centres: Array
    """(C, 3) mesh frame"""
    areas: Array
    """(C,) [m^2]"""

    @classmethod
    def of(cls, shell: Shell, *, limb: bool) -> DeclaredCells:
        middle = shell.grid[shell.triangles].mean(1) - [shell.length_m / 2, 0.0]
        if limb:
            middle = middle * [1.0, shell.radius_m]
        fine = shell.fine[shell.triangles].all(1)
        key = np.floor(middle / CELL_M + 0.5).astype(np.int64)
        _, number = np.unique(key[fine], axis=0, return_inverse=True)
        of_triangle = np.full(len(shell.triangles), -1, np.int64)
        of_triangle[fine] = number.ravel()
        corners = shell.vertices[shell.triangles[fine]]
        area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
        areas = np.bincount(number.ravel(), area).astype(np.float64)
        centres = np.stack([np.bincount(number.ravel(), area * x) for x in corners.mean(1).T], 1) / areas[:, None]
        return cls(of_triangle=of_triangle, centres=centres, areas=areas)


def add_tissue(
    spec: mujoco.MjSpec,
    body: Body,
    region: str,
    shell: Shell,
    tissue: Tissue,
    *,
    tools: str,
    tip: str = "",
    ledger: bool = False,
    on: str | None = None,
    floor: str | None = None,
) -> SoftRegion:
    """Add shell and bone core of one region. Call it after the skeleton.

    Args:
        tools: name of the body whose geoms, and those of the bodies under it, touch the shell.
        tip: name of the geom among them that is meant to touch; empty: all are.
        ledger: whether the energy of every step is kept.
        on: name of the body that carries the shell, whose origin is that of the segment's body; by default the
            segment's body.
        floor: name of the plate that carries the core, at the same place; by default the segment's body carries it.
    """
    origin = body.joint_centre[REGIONS[region].segment]
    limb = isinstance(REGIONS[region].shape, Tube)
    cells = DeclaredCells.of(shell, limb=limb)
    mesh = Mesh(
        places=shell.vertices - origin,
        inward=-shell.normals,
        along=shell.frame[:, 0],
        triangles=shell.triangles,
        areas=shell.area,
        cells=cells.of_triangle,
    )
    bone, lock = spec.body(on or body_name(REGIONS[region].segment)), LOCK if limb else 0.0
    contact = {"tools": tools, "tip": tip, "ledger": ledger, "lock": lock}
    add_region(spec, name=region, bone=bone, mesh=mesh, tissue=tissue, **contact)
    _add_core(spec, region, shell, tissue, origin, floor=floor)
    return SoftRegion(name=region, shell=shell, tissue=tissue, cells=cells)


def inner_surface(shell: Shell, thickness_m: float) -> Array:
    """Return the shell's vertices (N, 3), moved inward by the tissue's thickness, at most to near the axis."""
    room = np.einsum("ij,ij->i", shell.vertices - shell.axis_points, shell.normals) - CORE_MIN_RADIUS_M
    return shell.vertices - np.clip(thickness_m, 0.0, np.maximum(room, 0.0))[:, None] * shell.normals


def _add_core(
    spec: mujoco.MjSpec, region: str, shell: Shell, tissue: Tissue, origin: Array, *, floor: str | None
) -> None:
    """Add the rigid core that the tool meets under fully compressed tissue: convex wedges under the inner surface.

    One hull over the whole region would fill its hollows and be far too near to the skin. A wedge covers only
    CORE_PIECE_M along the region and a sector across it, down to the region's axis.
    """
    inner = inner_surface(shell, tissue.thickness_m) - origin
    axis = shell.axis_points - origin
    limb = isinstance(REGIONS[region].shape, Tube)
    middle = shell.grid[shell.triangles].mean(1)
    width = CORE_SECTOR_RAD if limb else CORE_PIECE_M
    key = np.floor(middle / [CORE_PIECE_M, width] + [0.0, 0.5]).astype(np.int64)
    bone = spec.body(floor or body_name(REGIONS[region].segment))
    for number, piece in enumerate(np.unique(key, axis=0)):
        corners = np.unique(shell.triangles[(key == piece).all(1)])
        points = np.concatenate([inner[corners], axis[corners]])
        name = f"human_core_{region}_{number}"
        add_hull(spec, bone, name, points, friction=tissue.friction, plate=floor is not None)

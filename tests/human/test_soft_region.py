"""The mechanics under the shell: core depth, coupling, membrane, and the cells that a region declares."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from carecontact.human.library import body_names, load_body
from carecontact.human.shell import Shell
from carecontact.human.skeleton import body_name
from carecontact.human.soft_region import (
    CELL_M,
    CORE_MIN_RADIUS_M,
    GROWTH,
    SPREADS,
    WIDEST,
    DeclaredCells,
    draw_tissue,
    inner_surface,
    stiffened,
    tissue_of,
)
from carecontact.interface.regions import REGIONS, STANDARD_REGIONS
from carecontact.lab.validation.rig import ABDOMEN, FOREARM, UPPER_ARM_ANTERIOR, Reference
from carecontact.protocol.load import load_protocol
from carecontact.protocol.overrides import overridden
from carecontact.protocol.person import Tissue
from carecontact.sim.bench import Bench, Indenter
from carecontact.tissue.plugin import Mesh
from carecontact.world.scene import build_scene, region_shell

PROTOCOL = load_protocol("bathing-v3")
ROWS, TOOL = PROTOCOL.person.tissue, Indenter(shape="cap")


def bench(region: str, tissue: Tissue, body: str = PROTOCOL.person.body) -> Bench:
    return Bench(body=load_body(body), region=region, tissue=tissue, indenter=TOOL)


def depths_of_core(made: Bench) -> tuple[np.ndarray, np.ndarray]:
    """Along the inward normals of the reachable patch: depth of the first core piece and room for it, (n,) [m]."""
    model, data = made.model, mujoco.MjData(made.model)
    mujoco.mj_forward(model, data)
    core = [g for g in range(model.ngeom) if model.geom(g).name.startswith("human_core_")]
    assert core
    bone = data.body(body_name(REGIONS[made.region].segment))
    shell = made.shell
    fine = np.flatnonzero(shell.fine)
    origins = shell.vertices[fine] - made.body.joint_centre[REGIONS[made.region].segment]
    np.testing.assert_allclose(bone.xpos, 0, atol=1e-12)
    depths = np.full(len(fine), np.inf)
    for k, (origin, normal) in enumerate(zip(origins, shell.normals[fine], strict=True)):
        hits = [mujoco.mj_rayMesh(model, data, g, origin, -normal, None) for g in core]
        depths[k] = min((h for h in hits if h >= 0), default=np.inf)
    room = np.einsum("ij,ij->i", shell.vertices - shell.axis_points, shell.normals)[fine] - CORE_MIN_RADIUS_M
    return depths, room


@pytest.mark.parametrize("region", STANDARD_REGIONS)
def test_core_lies_at_the_measured_depth(region: str) -> None:
    """The tool meets bone where the tissue is used up, neither sooner nor later, all over the reachable patch."""
    tissue = ROWS[region]
    depths, room = depths_of_core(bench(region, tissue))
    wanted = np.minimum(tissue.thickness_m, room)
    assert np.isfinite(depths).all()
    assert np.percentile(depths - wanted, 1) > -0.0015
    assert np.percentile(np.abs(depths - wanted), 95) < 0.001


BRIDGED = pytest.mark.xfail(
    strict=True, reason="a wedge of the core bridges the hollow where this upper arm narrows: 3.3 and 4.1 mm too high"
)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("region", "name"),
    [
        pytest.param(region, name, marks=BRIDGED if region == "upper_arm" and name.endswith("old-light") else ())
        for region in STANDARD_REGIONS
        for name in body_names()
    ],
)
def test_core_of_every_body(region: str, name: str) -> None:
    tissue = ROWS[region]
    depths, room = depths_of_core(bench(region, tissue, name))
    wanted = np.minimum(tissue.thickness_m, room)
    assert np.percentile(depths - wanted, 5) > (-0.003 if region == "upper_arm" else -0.001)
    assert np.median(np.abs(depths - wanted)) < 0.001


def test_inner_surface_stops_before_the_axis() -> None:
    shell = region_shell(load_body(PROTOCOL.person.body), "forearm", ROWS["forearm"])
    deep = inner_surface(shell, 1.0)
    left = np.einsum("ij,ij->i", deep - shell.axis_points, shell.normals)
    np.testing.assert_allclose(left, CORE_MIN_RADIUS_M, atol=1e-9)
    np.testing.assert_array_equal(inner_surface(shell, 0.0), shell.vertices)


def gradient_energy(shell: Shell, w: np.ndarray) -> float:
    """Integral of |grad w|^2 / 2 of the piecewise linear field, triangle by triangle."""
    total = 0.0
    for triangle in shell.triangles:
        a, b, c = shell.vertices[triangle]
        n = np.cross(b - a, c - a)
        area = np.linalg.norm(n) / 2
        n /= 2 * area
        grad = w[triangle] @ np.cross(n, [c - b, a - c, b - a]) / (2 * area)
        total += grad @ grad * area / 2
    return float(total)


def test_edges_carry_the_surface_gradients_energy() -> None:
    """Coupling and membrane are these weights times the squared differences of neighbours."""
    shell = region_shell(load_body(PROTOCOL.person.body), "abdomen", ROWS["abdomen"])
    cells, along = np.zeros(len(shell.triangles), np.int64), shell.frame[:, 0]
    surface = {"places": shell.vertices, "inward": -shell.normals, "triangles": shell.triangles, "areas": shell.area}
    mesh = Mesh(**surface, along=along, cells=cells)
    u = (shell.grid - shell.grid.mean(0)) / np.ptp(shell.grid, axis=0)
    w = 0.004 * np.cos(np.pi * u[:, 0]) * np.cos(np.pi * u[:, 1])
    edges, weights = mesh.edges
    assert (weights > 0).all()
    energy = 0.5 * float(weights @ (w[edges[:, 0]] - w[edges[:, 1]]) ** 2)
    assert energy == pytest.approx(gradient_energy(shell, w), rel=0.03)


def test_coupling_spreads_a_light_touch() -> None:
    """More anchors carry the load, so that the same depth takes more force."""
    plain = ROWS["forearm"].model_copy(update={"coupling_length_m": 0.0, "membrane_n_m": 0.0})
    depth = np.array([0.003])
    alone = bench("forearm", plain).response(depth, speed_m_s=0.01)
    spread = bench("forearm", plain.model_copy(update={"coupling_length_m": 0.005})).response(depth, speed_m_s=0.01)
    assert spread > 1.1 * alone


def glide_after_leaning_press(region: str, membrane_n_m: float) -> tuple[float, float]:
    """How far the skin glides under a ball that presses at 30 degrees, and the most by which neighbours differ [m]."""
    tissue = ROWS[region].model_copy(update={"membrane_n_m": membrane_n_m})
    body, ball = load_body(PROTOCOL.person.body), Indenter(shape="hemisphere", size_m=0.010)
    made = Bench(body=body, region=region, tissue=tissue, indenter=ball)
    made.press(depth_m=0.008, speed_m_s=0.02, tilt_deg=30.0)
    glide = made.felt.displacement(made.data)[:, 1:]
    pairs = np.sort(np.concatenate([np.roll(made.shell.triangles, -k, axis=1)[:, :2] for k in range(3)]), axis=1)
    apart = np.linalg.norm(glide[pairs[:, 0]] - glide[pairs[:, 1]], axis=1)
    return float(np.linalg.norm(glide, axis=1).max()), float(apart.max())


def test_the_membrane_takes_neighbours_along() -> None:
    alone, folded = glide_after_leaning_press("abdomen", 0.0)
    together, smooth = glide_after_leaning_press("abdomen", ROWS["abdomen"].membrane_n_m)
    assert smooth < 0.6 * folded
    assert together < alone


@pytest.mark.parametrize("region", STANDARD_REGIONS)
def test_declared_cells_tile_the_fine_part(region: str) -> None:
    shell = region_shell(load_body(PROTOCOL.person.body), region, ROWS[region])
    cells = DeclaredCells.of(shell, limb=region != "abdomen")
    corners = shell.vertices[shell.triangles]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    assert cells.areas.sum() == pytest.approx(area[cells.of_triangle >= 0].sum())
    assert (cells.of_triangle >= 0).sum() == shell.fine[shell.triangles].all(1).sum()
    assert np.unique(cells.of_triangle[cells.of_triangle >= 0]).tolist() == list(range(len(cells.areas)))
    assert np.median(cells.areas) == pytest.approx(CELL_M**2, rel=0.3)


@pytest.mark.parametrize("reference", [FOREARM, ABDOMEN], ids=lambda r: r.region)
def test_measured_depth_is_how_deep_the_references_presses_move_anchors(reference: Reference) -> None:
    tissue = {str(name): row for name, row in PROTOCOL.person.tissue.items()}[reference.region]
    made = Bench(body=load_body("man-adult"), region=reference.region, tissue=tissue, indenter=reference.indenter)
    press = made.press(depth_m=float(reference.depth_m[-1]), speed_m_s=0.01)
    assert press.anchor_m.max() == pytest.approx(tissue.measured_depth_m, rel=0.05)


@pytest.mark.parametrize("region", STANDARD_REGIONS)
def test_man_adult_keeps_the_rows_and_others_have_their_own(region: str) -> None:
    row = ROWS[region]
    assert tissue_of(load_body("man-adult"), region, row) is row
    slim, heavy = (tissue_of(load_body(name), region, row) for name in ("woman-old-light", "woman-old-heavy"))
    assert slim.thickness_m < row.thickness_m < heavy.thickness_m
    assert slim.a_n_m3 > row.a_n_m3 > heavy.a_n_m3
    assert heavy.thickness_m == pytest.approx(row.thickness_m + (32.0 - 22.6) * GROWTH[region].thickness_m)
    fields = ("a_n_m3", "b_n_m4", "c_n_m5", "damping_ns_m3", "thickness_m", "bmi_kg_m2")
    same = row.model_dump(exclude=set(fields))
    assert heavy.model_dump(exclude=set(fields)) == same, "only law and thickness follow the build"
    Tissue.model_validate(heavy.model_dump())
    assert tissue_of(load_body("man-old-heavy"), region, heavy) == heavy, "a row that is of this build stays"


def test_rows_without_a_build_and_other_regions_are_the_same_on_every_body() -> None:
    heavy = load_body("man-adult-heavy")
    plain = ROWS["forearm"].model_copy(update={"bmi_kg_m2": None})
    assert tissue_of(heavy, "forearm", plain) is plain
    assert tissue_of(heavy, "right_thigh", ROWS["forearm"]) is ROWS["forearm"]


def test_beyond_the_published_builds_tissue_grows_no_further() -> None:
    row = ROWS["abdomen"].model_copy(update={"bmi_kg_m2": 60.0})
    heaviest = ROWS["abdomen"].model_copy(update={"bmi_kg_m2": 40.0})
    body = load_body("man-adult")
    assert tissue_of(body, "abdomen", row) == tissue_of(body, "abdomen", heaviest)
    assert round(body.bmi, 1) == 22.6


def test_a_stiffened_law_is_as_far_from_critical_and_as_convex() -> None:
    row = ROWS["abdomen"]
    for factor in (0.3, 1.0, 3.0):
        made = stiffened(row, factor)
        depth = np.linspace(0, 0.03, 7)
        law, before = (r.a_n_m3 * depth + r.b_n_m4 * depth**2 + r.c_n_m5 * depth**3 for r in (made, row))
        np.testing.assert_allclose(law, factor * before, rtol=1e-12)
        assert made.damping_ns_m3 / row.damping_ns_m3 == pytest.approx((made.a_n_m3 / row.a_n_m3) ** 0.5)
        assert made.b_n_m4**2 / (made.a_n_m3 * made.c_n_m5) == pytest.approx(row.b_n_m4**2 / (row.a_n_m3 * row.c_n_m5))


def test_the_world_has_the_tissue_of_its_body() -> None:
    rules = overridden(load_protocol("bathing-v3"), {"person.body": "man-adult-heavy"})
    scene = build_scene(rules, target=None, skin=False)
    for name, region in scene.regions.items():
        assert region.tissue == tissue_of(scene.body, name, rules.person.tissue[name])
        assert region.tissue.thickness_m > rules.person.tissue[name].thickness_m


FEW, MANY = 40, 4000


def factors(count: int) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(5)
    drawn = [draw_tissue(rng, ROWS) for _ in range(count)]
    return {name: np.array([row[name].a_n_m3 for row in drawn]) / ROWS[name].a_n_m3 for name in drawn[0]}


@pytest.mark.parametrize("reference", [FOREARM, UPPER_ARM_ANTERIOR, ABDOMEN], ids=lambda r: r.region)
def test_the_quantiles_are_the_sources(reference: Reference) -> None:
    """Of 4,000 draws, the 5th and 95th percentile have a standard error of some 2 percent of the spread."""
    low, middle, high = (curve[-1] for curve in (reference.low_n, reference.force_n, reference.high_n))
    spread = SPREADS[reference.region]
    assert (spread.p5, spread.p95) == pytest.approx((low / middle, high / middle), rel=1e-3)
    found = np.quantile(factors(MANY)[reference.region], [0.05, 0.5, 0.95])
    np.testing.assert_allclose(found, [spread.p5, 1.0, spread.p95], rtol=0.04)


def test_a_person_is_soft_on_the_whole_arm_and_on_the_belly_by_another_draw() -> None:
    found = {name: np.log(values) for name, values in factors(FEW).items()}
    np.testing.assert_array_equal(np.sign(found["forearm"]), np.sign(found["upper_arm"]))
    assert abs(np.corrcoef(found["forearm"], found["abdomen"])[0, 1]) < 0.5


def test_every_draw_can_be_a_row_of_tissue() -> None:
    """The widest draws too: convex, and with a contact layer that can be solved."""
    for spread in SPREADS.values():
        assert spread.factor(-9) == spread.factor(-WIDEST) < spread.p5 < 1 < spread.p95 < spread.factor(WIDEST)
        assert spread.factor(0.0) == 1.0
    rng = np.random.default_rng(0)
    for _ in range(FEW):
        for row in draw_tissue(rng, ROWS).values():
            Tissue.model_validate(row.model_dump())


def test_a_region_without_published_spread_keeps_its_tissue() -> None:
    assert "right_hand" not in draw_tissue(np.random.default_rng(0), {**ROWS, "right_hand": ROWS["forearm"]})

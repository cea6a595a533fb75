"""The mechanics under the shell: core depth, coupling, and what the compiled model says of them."""

from __future__ import annotations

from bisect import bisect_left

import mujoco
import numpy as np
import pytest

from carecontact.contract.protocol import Tissue
from carecontact.errors import ConfigError
from carecontact.protocols import FAST_DT_S, load_protocol, overridden
from carecontact.regions import REGIONS, STANDARD_REGIONS
from carecontact.sim.bench import Bench, Indenter
from carecontact.validation.reference import ABDOMEN, FOREARM, Reference
from carecontact.world.human.library import body_names, load_body
from carecontact.world.human.shell import Shell
from carecontact.world.human.skeleton import body_name
from carecontact.world.human.tissue import (
    CORE_MIN_RADIUS_M,
    check_step,
    coupling_tendons,
    inner_surface,
    membrane_weights,
)
from carecontact.world.scene import build_scene, region_shell

PROTOCOL = load_protocol()
TOOL = Indenter(shape="cap")


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
    tissue = PROTOCOL.person.tissue[region]
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
    tissue = PROTOCOL.person.tissue[region]
    depths, room = depths_of_core(bench(region, tissue, name))
    wanted = np.minimum(tissue.thickness_m, room)
    assert np.percentile(depths - wanted, 5) > (-0.003 if region == "upper_arm" else -0.001)
    assert np.median(np.abs(depths - wanted)) < 0.001


def test_inner_surface_stops_before_the_axis() -> None:
    shell = region_shell(load_body(PROTOCOL.person.body), "forearm", PROTOCOL.person.tissue["forearm"])
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
        grad = (w[triangle[0]] * np.cross(n, c - b) + w[triangle[1]] * np.cross(n, a - c)
                + w[triangle[2]] * np.cross(n, b - a)) / (2 * area)  # fmt: skip
        total += grad @ grad * area / 2
    return float(total)


def test_coupling_is_the_surface_gradients_energy() -> None:
    tissue = PROTOCOL.person.tissue["abdomen"].model_copy(update={"coupling_length_m": 0.006})
    made = bench("abdomen", tissue)
    model, shell = made.model, made.shell
    assert model.ntendon > 1000
    data = mujoco.MjData(model)
    # A bump that is zero at the pinned border.
    u = (shell.grid - shell.grid.mean(0)) / np.ptp(shell.grid, axis=0)
    w = np.where(shell.pinned, 0.0, 0.004 * np.cos(np.pi * u[:, 0]) * np.cos(np.pi * u[:, 1]))
    for k in np.flatnonzero(~shell.pinned):
        data.qpos[model.joint(f"abdomen_v{k}_n").qposadr[0]] = w[k]
    mujoco.mj_fwdPosition(model, data)
    energy = 0.5 * float(model.tendon_stiffness @ data.ten_length**2)
    assert len(coupling_tendons(model, "abdomen")) > 1000
    assert energy == pytest.approx(tissue.a_n_m3 * 0.006**2 * gradient_energy(shell, w), rel=0.03)


def test_coupling_spreads_a_light_touch() -> None:
    """More anchors carry the load, so the same depth takes more force; and none at all takes no tendons."""
    plain = PROTOCOL.person.tissue["forearm"].model_copy(update={"coupling_length_m": 0.0, "membrane_n_m": 0.0})
    alone = bench("forearm", plain)
    assert alone.model.ntendon == 0
    spread = bench("forearm", plain.model_copy(update={"coupling_length_m": 0.005}))
    depth = np.array([0.003])
    assert spread.response(depth, speed_m_s=0.01) > 1.1 * alone.response(depth, speed_m_s=0.01)


def cells(made: Bench, kind: str) -> np.ndarray:
    """Joint numbers of the cells' slides."""
    return np.array([made.model.joint(f"{made.region}_cell{c}_{kind}").id for c in range(len(made.shell.cell_frames))])


@pytest.mark.parametrize("region", ["forearm", "abdomen"])
def test_membrane_is_the_glides_gradient_energy(region: str) -> None:
    """A glide that grows evenly along the region stores K / 2 times its squared gradient times the area."""
    tissue = PROTOCOL.person.tissue[region].model_copy(update={"coupling_length_m": 0.0})
    made = bench(region, tissue)
    model, shell = made.model, made.shell
    middle = np.array([shell.grid[shell.cell == c, 0].mean() for c in range(len(shell.cell_frames))])
    data = mujoco.MjData(model)
    gradient = 0.05
    data.qpos[model.jnt_qposadr[cells(made, "t")]] = gradient * middle
    mujoco.mj_fwdPosition(model, data)
    energy = 0.5 * float(model.tendon_stiffness @ data.ten_length**2)
    # Half a cell at either end of the region has no neighbour beyond it.
    area = float(shell.area[shell.cell >= 0].sum()) * np.ptp(middle) / np.ptp(shell.grid[shell.cell >= 0, 0])
    assert energy == pytest.approx(tissue.membrane_n_m * gradient**2 / 2 * area, rel=0.12)


def test_skin_that_is_dragged_takes_its_neighbours_along() -> None:
    """Alone, a patch under 4 N of friction moves so far past its neighbour that the triangles between them fold."""
    step: dict[float, float] = {}
    for membrane in (0.0, PROTOCOL.person.tissue["abdomen"].membrane_n_m):
        made = bench("abdomen", PROTOCOL.person.tissue["abdomen"].model_copy(update={"membrane_n_m": membrane}))
        model, data = made.model, mujoco.MjData(made.model)
        data.qpos[model.joint("indenter").qposadr[0]] = -0.05
        joints = cells(made, "t")
        pulled = int(np.linalg.norm(made.shell.grid[made.shell.fine].mean(0) - np.array(
            [made.shell.grid[made.shell.cell == c].mean(0) for c in range(len(joints))]), axis=1).argmin())  # fmt: skip
        data.qfrc_applied[model.jnt_dofadr[joints[pulled]]] = 4.0
        for _ in range(500):
            mujoco.mj_step(model, data)
        glide = data.qpos[model.jnt_qposadr[joints]]
        pairs, _ = membrane_weights(made.shell)
        step[membrane] = float(np.abs(np.diff(glide[pairs], axis=1)).max())
    alone, together = step.values()
    assert alone > 0.004
    assert together < 0.0015


def test_springs_too_stiff_for_the_time_step_are_told() -> None:
    person = PROTOCOL.person
    stiff = person.tissue["forearm"].model_copy(update={"coupling_length_m": 0.02})
    other = person.model_copy(update={"tissue": {**person.tissue, "forearm": stiff}})
    with pytest.raises(
        ConfigError, match=r"coupling_length_m 0.02 on a mesh of 8 mm is unstable at time steps of 2 ms"
    ):
        build_scene(PROTOCOL.model_copy(update={"person": other}), target="forearm", skin=False)


def test_membrane_too_stiff_for_the_time_step_is_told() -> None:
    tissue = PROTOCOL.person.tissue["forearm"].model_copy(update={"membrane_n_m": 20_000.0})
    shell = region_shell(load_body("man-adult"), "forearm", tissue)
    with pytest.raises(ConfigError, match=r"membrane_n_m 20000 on a mesh of 8 mm is unstable at time steps of 4 ms"):
        check_step("forearm", shell, tissue, 0.004)


@pytest.mark.parametrize("name", ["paper-mapping", "human-published", "manikin-like"])
def test_shipped_sets_are_stable_in_the_fast_mode(name: str) -> None:
    build_scene(
        overridden(PROTOCOL, {"person.tissue_set": name, "physics.dt_s": FAST_DT_S}), target="forearm", skin=False
    )


def test_the_step_limit_is_the_integrators() -> None:
    """A shell left ringing at a step just inside the limit calms down, and at one well outside it does not."""
    tissue = PROTOCOL.person.tissue["forearm"].model_copy(update={"coupling_length_m": 0.012})
    shell = bench("forearm", tissue).shell

    def refused(dt_s: float) -> bool:
        try:
            check_step("forearm", shell, tissue, dt_s)
        except ConfigError:
            return True
        return False

    steps = np.arange(0.0010, 0.0100, 0.0002).tolist()
    longest = steps[bisect_left(steps, True, key=refused) - 1]
    assert steps[0] < longest < steps[-1]
    for factor, calms in ((0.9, True), (1.2, False)):
        made = Bench(
            body=load_body("man-adult"), region="forearm", tissue=tissue, shell=shell,
            indenter=Indenter(shape="cap"), dt_s=longest * factor,
        )  # fmt: skip
        data = mujoco.MjData(made.model)
        joints = [made.model.joint(f"forearm_v{k}_n").qposadr[0] for k in np.flatnonzero(~shell.pinned)]
        data.qpos[joints] = 1e-6 * np.random.default_rng(0).normal(size=len(joints))
        data.qpos[made.model.joint("indenter").qposadr[0]] = -0.015
        for _ in range(400):
            mujoco.mj_step(made.model, data)
        # MuJoCo resets a state that diverged; the warning is all that tells of it.
        grew = np.abs(data.qpos[joints]).max() > 1e-6 or any(w.number for w in data.warning)
        assert grew != calms, (longest, factor)


@pytest.mark.parametrize("reference", [FOREARM, ABDOMEN], ids=lambda r: r.region)
def test_measured_depth_is_how_deep_the_references_presses_move_anchors(reference: Reference) -> None:
    tissue = {str(name): row for name, row in PROTOCOL.person.tissue.items()}[reference.region]
    made = Bench(body=load_body("man-adult"), region=reference.region, tissue=tissue, indenter=reference.indenter)
    press = made.press(depth_m=float(reference.depth_m[-1]), speed_m_s=0.01)
    assert (press.anchor_m <= press.indentation_m + 1e-4).all()
    assert press.anchor_m.max() == pytest.approx(tissue.measured_depth_m, rel=0.05)

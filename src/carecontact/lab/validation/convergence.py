"""Check 3: the scores do not depend on the time step or on the mesh. It also reports how the force grows with the
tool's size."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise, product
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from carecontact.errors import ConfigError, SceneError
from carecontact.human.shell import Shell
from carecontact.lab.validation.result import Array, CheckResult, Figure, Measure, measured
from carecontact.lab.validation.rig import (
    ABDOMEN,
    FOREARM,
    HEAVY_KG,
    UPPER_ARM_ANTERIOR,
    Reference,
    Rig,
    declared_bench,
    middle,
    robot_tool,
    tool,
)
from carecontact.lab.validation.subject import PRESS, SCRUB, Motion, Scores, Subject, motion_scores
from carecontact.protocol.person import Tissue
from carecontact.sim.bench import Bench, Indenter, Shape

if TYPE_CHECKING:
    from matplotlib.axes import Axes

TITLE = "Convergence in time step and mesh"
MOTIONS = (PRESS, SCRUB)
NAMES = {"c1_n": "C1", "c1_filtered_n": "C1 at 100 Hz", "c5_n": "C5", "stroke_m": "stroke"}
STEP_LIMIT_PERCENT = {"c1_n": 2.0, "c1_filtered_n": 2.0, "c5_n": 5.0, "stroke_m": 2.0}
MESH_LIMIT_PERCENT = 5.0
FINER, FINEST_M = 0.7, 0.0025
"""Share of the shipped spacing at which a law is fitted again (3.5 mm for a mesh of 5 mm), and spacing [m] of the mesh
on which the tool scrubs, with the shipped law, a region whose bone is held."""
SCRUB_DEPTH_M, SCRUB_HALF_M, SCRUB_M_S, SCRUB_FROM_M = 0.008, 0.040, 0.10, 0.004
"""Of the scrub: depth under the undeformed skin along the region's outward direction, distance to each side, speed
along the skin, and height above the skin at which the tool begins."""
TOUCHED_N = 0.5
"""Force from which that scrub counts as contact, as in contact-v1."""
MESH_REFERENCES = (FOREARM, UPPER_ARM_ANTERIOR, ABDOMEN)
"""Indenter and depths at which meshes are compared; whether the law was fitted to that curve makes no difference."""
Places = tuple[tuple[float, float], ...]
PLACES_M: Places = ((0.0, 0.0), (0.020, 0.008))
"""Places (along, across) in the region's frame at which a law is fitted to a finer mesh."""
HELD_OUT_M: Places = ((-0.018, -0.006), (0.034, 0.002))
"""Places at which the two meshes are then compared."""
TOOL_DEPTHS_M = np.linspace(0.001, 0.008, 8)
RECALIBRATIONS = 2
LAWS = ("same law", "law fitted anew")
RADIUS_FACTORS = (0.5, 1.0, 2.0)
TREND_DEPTH_M = 0.004


@dataclass(frozen=True, kw_only=True)
class Trend:
    region: str
    shape: Shape
    radius_m: float
    """The middle one of three radii."""
    layer: tuple[float, float] | None = None
    """Exponents of force over radius for an incompressible elastic layer bonded to bone, 50 and 30 mm thick, which a
    test computes (sphere: Dimitriadis et al. 2002, Biophys J 82:2798; flat: Hayes et al. 1972, J Biomech 5:541). None
    for limbs, which are too narrow to count as a layer."""


TRENDS = {
    "forearm, flat": Trend(region="forearm", shape="flat", radius_m=0.0107),
    "abdomen, sphere": Trend(region="abdomen", shape="hemisphere", radius_m=0.010, layer=(0.58, 0.65)),
    "abdomen, flat": Trend(region="abdomen", shape="flat", radius_m=0.0107, layer=(1.31, 1.52)),
}
"""Both calibration indenters, and a disc on the region for which the theory of a layer predicts the exponent."""


def run(subject: Subject, *, quick: bool) -> CheckResult:
    measures: list[Measure] = []
    curves: dict[str, Array] = {}
    dt, regions, motions = subject.protocol.physics.dt_s, subject.regions(quick=quick), (SCRUB,) if quick else MOTIONS
    shipped = {region: _scores(subject, region, motions) for region in regions}
    # Twice the protocol's step is the fast mode, which must give the same scores.
    for factor in (0.5,) if quick else (0.5, 2.0):
        other = subject.with_dt(dt * factor)
        for region in regions:
            what = f"{region}: time step {1000 * dt:g} to {1000 * dt * factor:g} ms"
            for motion, field, change in _changes(shipped[region], _scores(other, region, motions)):
                limit = STEP_LIMIT_PERCENT[field]
                measures.append(measured(f"{what}, {motion} {NAMES[field]}", change, "%", at_most=limit))
    for reference in () if quick else MESH_REFERENCES:
        try:
            measures += mesh(subject, reference, shipped[reference.region], curves)
            measures += finest_scrub(subject, reference.region)
        except (SceneError, ConfigError) as error:
            # Without this measure, the others are still useful.
            name = f"{reference.region}: finer mesh, not measured: {error}"
            measures.append(measured(name, np.nan, "%", at_most=MESH_LIMIT_PERCENT))
    for name, size in () if quick else TRENDS.items():
        radii, forces = size.radius_m * np.array(RADIUS_FACTORS), trend(subject, size)
        layer = "" if size.layer is None else " (bonded layer: {} to {})".format(*size.layer)
        exponent = np.polyfit(np.log(radii), np.log(forces), 1)[0]
        measures.append(measured(f"tool radius x 0.5, 1, 2, {name}: exponent of force{layer}", exponent))
        curves[f"trend/{name}"] = np.stack([1000 * radii, forces])
    curves["changes"] = np.array([[m.value, m.limit or 0.0] for m in measures if m.limit is not None])
    return CheckResult(check="convergence", title=TITLE, measures=tuple(measures), curves=curves)


def _scores(subject: Subject, region: str, motions: Sequence[Motion]) -> dict[str, Scores]:
    return {motion.name: motion_scores(subject, region, motion) for motion in motions}


def _changes(before: dict[str, Scores], after: dict[str, Scores]) -> Iterator[tuple[str, str, float]]:
    """Yield triples of motion, score and change [%]; a press has no stroke."""
    for motion, field in product(before, NAMES):
        if motion != PRESS.name or field != "stroke_m":
            old, new = getattr(before[motion], field), getattr(after[motion], field)
            yield motion, field, float(100 * abs(new / old - 1))


def mesh(subject: Subject, reference: Reference, coarse: dict[str, Scores], curves: dict[str, Array]) -> list[Measure]:
    """Measure the change on a finer mesh: with the same law per area, and with the law fitted again at the calibration
    indenter.

    A law belongs to a mesh, because a coarser mesh spreads a small tool's load farther, for which the fit compensates.
    """
    region, indenter, depths = reference.region, reference.indenter, reference.depth_m[1:]
    tissue = subject.tissue(region)
    spacing = {name: FINER * getattr(tissue, name) for name in ("spacing_m", "coarse_spacing_m")}
    fine = subject.with_tissue(region, tissue.model_copy(update=spacing))
    shipped, bench = (declared_bench(person, region, indenter) for person in (subject, fine))
    wanted, same_law = (_mean_response(of, depths, HELD_OUT_M) for of in (shipped, bench))
    fitted = recalibrated(bench, depths, _mean_response(shipped, depths, PLACES_M))
    new_law = _mean_response(bench, depths, HELD_OUT_M)
    shipped_tool, fine_tool = (declared_bench(person, region, tool(subject)) for person in (subject, fine))
    at_tool, tool_same = (_mean_response(of, TOOL_DEPTHS_M, HELD_OUT_M) for of in (shipped_tool, fine_tool))
    fine_tool.set_law(fitted)
    tool_new = _mean_response(fine_tool, TOOL_DEPTHS_M, HELD_OUT_M)
    scene = _scores(fine.with_tissue(region, fitted), region, MOTIONS)
    curves[f"mesh/{region}/reference"] = np.stack([1000 * depths, wanted, same_law, new_law])
    curves[f"mesh/{region}/tool"] = np.stack([1000 * TOOL_DEPTHS_M, at_tool, tool_same, tool_new])
    same, refit = (f"{region}: mesh of {1000 * spacing['spacing_m']:g} mm, {law}" for law in LAWS)
    rows = {
        f"{same}, calibration indenter": _nrmse(same_law, wanted),
        f"{same}, tool": _nrmse(tool_same, at_tool),
        f"{refit}, calibration indenter": _nrmse(new_law, wanted),
        f"{refit}, tool": _nrmse(tool_new, at_tool),
    }
    rows |= {f"{refit}, {motion} {NAMES[field]}": change for motion, field, change in _changes(coarse, scene)}
    return [
        measured(name, value, "%", at_most=MESH_LIMIT_PERCENT, decides=name.startswith(refit))
        for name, value in rows.items()
    ]


def finest_scrub(subject: Subject, region: str) -> list[Measure]:
    """Scrub the held region with the robot's tool at one depth, on the shipped mesh and on one so fine that it
    approximates a continuous surface, both with the shipped law."""
    tissue = subject.tissue(region)
    coarse = min(tissue.coarse_spacing_m, tissue.coarse_spacing_m * FINEST_M / tissue.spacing_m)
    finest = subject.with_tissue(region, tissue.model_copy(update={"spacing_m": FINEST_M, "coarse_spacing_m": coarse}))
    shell = subject.scene(region).regions[region].shell
    at = middle(shell)
    skin = _over_the_skin(shell, *at)
    (peak, spread), (wanted_peak, wanted_spread) = (_held_scrub(s, region, at, skin) for s in (subject, finest))
    what = f"{region}: scrub {1000 * SCRUB_DEPTH_M:g} mm deep, mesh of {1000 * FINEST_M:g} mm, same law"
    changes = {"C1": peak / wanted_peak, "C5": spread / wanted_spread}
    return [
        measured(f"{what}, {name}", 100 * abs(change - 1), "%", at_most=MESH_LIMIT_PERCENT)
        for name, change in changes.items()
    ]


def _over_the_skin(shell: Shell, point: Array, frame: Array) -> np.polynomial.Polynomial:
    """Return the height [m] of the undeformed skin over the region's middle by the place along the region [m]."""
    x, y, z = ((shell.vertices - point) @ frame).T
    line = (np.abs(y) < 0.012) & (np.abs(x) < SCRUB_HALF_M + 0.02) & (shell.normals @ frame[:, 2] > 0)
    return np.polynomial.Polynomial.fit(x[line], z[line], 4)


def _held_scrub(
    subject: Subject, region: str, at: tuple[Array, Array], skin: np.polynomial.Polynomial
) -> tuple[float, float]:
    """Return peak and standard deviation [N] of the force while the tool presses and goes once back and forth."""
    rig = Rig(subject, region, robot_tool(subject), joints="slides", mass_kg=HEAVY_KG, at=at)
    dt, data = rig.model.opt.timestep, rig.data
    down = np.arange(0.0, SCRUB_DEPTH_M + SCRUB_FROM_M, SCRUB_M_S / 2 * dt)
    across = np.arange(-SCRUB_HALF_M, SCRUB_HALF_M, SCRUB_M_S * dt)
    x = np.r_[np.full(len(down), -SCRUB_HALF_M), across, across[::-1]]
    z = skin(x) - np.r_[down - SCRUB_FROM_M, np.full(2 * len(across), SCRUB_DEPTH_M)]
    path = np.stack([x, z], 1)
    rig.reset(position=path[0])
    force = []
    for place, following in pairwise(path):
        data.qpos[:], data.qvel[:] = place, (following - place) / dt
        mujoco.mj_step(rig.model, data)
        force.append(float(np.linalg.norm(rig.felt.last(data, 1)[0]["force_n"])))
    norm = np.array(force)
    return float(norm.max()), float(norm[norm >= TOUCHED_N].std())


def _mean_response(bench: Bench, depths: Array, places: Places) -> Array:
    return np.mean([bench.response(depths, along_m=x, across_m=y, speed_m_s=0.010) for x, y in places], axis=0)


def _nrmse(got: Array, wanted: Array) -> float:
    return float(100 * np.sqrt(np.mean((got - wanted) ** 2)) / wanted.max())


def recalibrated(bench: Bench, depths: Array, wanted: Array) -> Tissue:
    """Fit the stiffness to the forces ``wanted``, the mean over PLACES_M, set it on the bench and return it.

    One factor scales a and b, another one c. Gauss-Newton steps on the logarithms of the factors suffice, because both
    act almost linearly.
    """
    start = bench.tissue

    def law(p: Array) -> Tissue:
        first, second = np.exp(p)
        factors = {"a_n_m3": first, "b_n_m4": first, "c_n_m5": second}
        return start.model_copy(update={name: getattr(start, name) * factor for name, factor in factors.items()})

    def response(p: Array) -> Array:
        bench.set_law(law(p))
        return _mean_response(bench, depths, PLACES_M)

    p, step = np.zeros(2), 0.1
    for _ in range(RECALIBRATIONS):
        base = response(p)
        jacobian = np.stack([(response(p + step * e) - base) / step for e in np.eye(2)], 1)
        p = p + np.clip(np.linalg.lstsq(jacobian, wanted - base, rcond=None)[0], -1.0, 1.0)
    bench.set_law(law(p))
    return law(p)


def trend(subject: Subject, size: Trend) -> Array:
    """Return the force (3,) [N] at TREND_DEPTH_M for RADIUS_FACTORS."""
    indenters = [Indenter(shape=size.shape, size_m=size.radius_m * factor) for factor in RADIUS_FACTORS]
    benches = [declared_bench(subject, size.region, indenter) for indenter in indenters]
    return np.array([bench.response(np.array([TREND_DEPTH_M]))[0] for bench in benches])


def draw(result: CheckResult, figure: Figure) -> None:
    regions = [r.region for r in MESH_REFERENCES if f"mesh/{r.region}/tool" in result.curves]
    panels = 1 + len(regions) + bool(regions)
    figure.set_size_inches(0.1 + 2.3 * panels, 2.7)
    axes = np.atleast_1d(figure.subplots(1, panels))
    _draw_step(result.measures, axes[0])
    for panel, region in zip(axes[1:], regions, strict=False):
        highest = 0.0
        for kind, style, where in (("reference", "-", "calibration indenter"), ("tool", "--", "tool")):
            depth, shipped, same, fitted = result.curves[f"mesh/{region}/{kind}"]
            same_law, refit = ("finer, same law", "finer, fitted") if kind == "reference" else (None, None)
            panel.plot(depth, shipped, style, color="k", label=f"shipped mesh, {where}")
            panel.plot(depth, same, style, color="C1", lw=0.9, label=same_law)
            panel.plot(depth, fitted, style, color="C0", lw=0.9, label=refit)
            # A press that diverged must not hide the results of the others.
            highest = max(highest, shipped.max())
        panel.set(xlabel="indentation [mm]", title=region.replace("_", " "), ylim=(0, 1.25 * highest))
    if regions:
        axes[1].set_ylabel("force [N]")
        figure.legend(*axes[1].get_legend_handles_labels(), loc="outside lower center", ncols=4)
        _draw_trends(result.curves, axes[-1])


def _draw_trends(curves: Mapping[str, Array], axes: Axes) -> None:
    highest = 0.0
    for name, size in TRENDS.items():
        radius, force = curves[f"trend/{name}"]
        (line,) = axes.loglog(radius, force, "o-", ms=3, label=name)
        for exponent in size.layer or ():
            axes.loglog(radius, force[1] * (radius / radius[1]) ** exponent, ":", color=line.get_color(), lw=0.8)
        highest = max(highest, force.max())
    axes.set(xlabel="tool radius [mm]", ylabel="force [N]", title="tool size (dotted: layer)")
    axes.set_ylim(None, 20 * highest)
    axes.minorticks_off()
    axes.set_xticks([5, 10, 20], ["5", "10", "20"])
    axes.set_yticks([0.5, 1, 2, 4, 8], ["0.5", "1", "2", "4", "8"])
    axes.legend(loc="upper left")


def _draw_step(measures: Sequence[Measure], axes: Axes) -> None:
    rows = [(*m.name.partition(":")[::2], m) for m in measures if "time step" in m.name]
    labels = list(dict.fromkeys(rest.partition(", ")[2] for _, rest, _ in rows))
    limits, regions = np.zeros(len(labels)), list(dict.fromkeys(region for region, *_ in rows))
    for region in regions:
        mine = [(labels.index(rest.partition(", ")[2]), m) for its, rest, m in rows if its == region]
        for at, m in mine:
            limits[at] = m.limit or 0.0
        at, values = np.array([(at, m.value) for at, m in mine]).T
        half = len(labels)
        (dots,) = axes.plot(values[:half], at[:half], "o", ms=4, label=region.replace("_", " "))
        axes.plot(values[half:], at[half:], "x", ms=4, color=dots.get_color())
    axes.plot(limits, range(len(labels)), "|", color="0.3", ms=12)
    axes.set_yticks(range(len(labels)), labels)
    both = len(rows) > len(labels) * len(regions)
    title = "half (o), twice (x) the step" if both else "half the step"
    # The names need room on the right, beyond the largest change.
    farthest = max([m.value for *_, m in rows] + [1.0, *limits])
    axes.set(xlabel="change [%] and its limit (|)", title=title, xlim=(0, 2.2 * farthest))
    axes.invert_yaxis()
    axes.legend(loc="upper right")

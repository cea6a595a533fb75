"""Tests that the same indentation needs nearly the same force wherever the tool lands on the target."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from carecontact.human.shell import Shell
from carecontact.lab.validation.result import Array, CheckResult, Figure, Measure, measured
from carecontact.lab.validation.rig import person_bench, tool
from carecontact.lab.validation.subject import Subject
from carecontact.sim.bench import Bench

TITLE = "Uniformity over the target"
DEPTHS_M, TANGENT_M = (0.004, 0.008), 0.001
"""Depths at which forces are compared, and how far above each the force is read as well, for the slope there."""
MOVED_PERCENT, UNEXPLAINED_PERCENT = 5.0, 4.0
"""docs/evidence/validation.md derives both from what a score needs."""
PLACES, QUICK_PLACES = 60, 20
"""Number of places. The variation over n places has a relative standard error of 1 / sqrt(2 (n - 1)), a sixth for 20
and a tenth for 60, so that the limit judges the region more than the draw."""
SEED = 20
BORDER_M = 0.019
"""Width that is kept free along the mask's border: half the cap's width. The wash mitt is wider, and covers skin beyond
the mask."""
UPWARD = 0.5
"""Least cosine between normals in the mask, which a tool from above touches, and the region's outward direction: 60
degrees."""
SPEED_M_S = 0.010


def run(subject: Subject, *, quick: bool) -> CheckResult:
    measures: list[Measure] = []
    curves: dict[str, Array] = {}
    spring = subject.protocol.impedance.translational_bounds[1]
    for region in subject.regions(quick=quick):
        bench = person_bench(subject, region, tool(subject))
        shell, rng = bench.shell, np.random.default_rng([SEED, subject.regions().index(region)])
        places = random_places(shell, rng, QUICK_PLACES if quick else PLACES)
        force = np.array([_press(bench, place) for place in places])
        curvature = np.array([curvatures(shell, place) for place in places])
        for depth, (above, column) in zip(DEPTHS_M, force.transpose(1, 2, 0), strict=True):
            at, slope = f"at {1000 * depth:.0f} mm", float((column - above).mean()) / TANGENT_M
            variation = float(100 * column.std(ddof=1) / column.mean())
            moved, left = variation * spring / (spring + slope), 100 * unexplained(column, curvature)
            pressed = f"{region}: the same {at}, of a robot with a spring of {spring:g} N/m that goes so deep"
            curved = f"{region}: the same {at}, without what the body's curvature explains"
            measures += [
                measured(f"{region}: variation of peak force over {len(places)} places {at}", variation, "%"),
                measured(pressed, moved, "%", at_most=MOVED_PERCENT),
                measured(curved, left, "%", at_most=UNEXPLAINED_PERCENT),
            ]
        free = f"{region}: share of the mask that is farther than {1000 * BORDER_M:.0f} mm from its border"
        measures.append(measured(free, 100 * shell.area[inner(shell)].sum() / shell.area[mask(shell)].sum(), "%"))
        curves[f"{region}/points"] = np.c_[_flat(shell), mask(shell)][_upward(shell)]
        curves |= {f"{region}/places": places, f"{region}/force": force[:, :, 1]}
    return CheckResult(check="uniformity", title=TITLE, measures=tuple(measures), curves=curves)


def _press(bench: Bench, place: Array) -> Array:
    """Return the force (depths, 2) [N] TANGENT_M above each of DEPTHS_M, and there."""
    depths = np.add.outer(DEPTHS_M, (-TANGENT_M, 0.0))
    force = bench.response(depths.ravel(), along_m=place[0], across_m=place[1], speed_m_s=SPEED_M_S)
    return force.reshape(depths.shape)


def curvatures(shell: Shell, place: Array) -> Array:
    """Return the curvatures (2,) [1/m] of the undeformed surface, along the region and across it, at a place (along,
    across): those of the quadric that best fits the vertices within BORDER_M."""
    local = (shell.vertices - shell.frame_origin) @ shell.frame
    x, y, z = local[_upward(shell) & (np.linalg.norm(local[:, :2] - place, axis=1) < BORDER_M)].T
    x, y = x - place[0], y - place[1]
    terms = np.stack([np.ones_like(x), x, y, x * y, x**2, y**2], 1)
    _, sx, sy, _, along, across = np.linalg.lstsq(terms, z, rcond=None)[0]
    # A slope appears shorter when it is seen from above.
    return -2 * np.array([along / (1 + sx**2), across / (1 + sy**2)]) / np.sqrt(1 + sx**2 + sy**2)


def unexplained(force: Array, curvature: Array) -> float:
    """Return the spread of the force that a linear law of both curvatures does not explain, over the mean force."""
    terms = np.c_[np.ones(len(force)), curvature]
    left = force - terms @ np.linalg.lstsq(terms, force, rcond=None)[0]
    return float(np.sqrt((left**2).sum() / (len(force) - terms.shape[1])) / force.mean())


def _flat(shell: Shell) -> Array:
    """Return the places (N, 2) [m] of the vertices, along and across, in the region's frame."""
    return ((shell.vertices - shell.frame_origin) @ shell.frame)[:, :2]


def _upward(shell: Shell) -> npt.NDArray[np.bool_]:
    return shell.normals @ shell.frame[:, 2] > 0.0


def mask(shell: Shell) -> npt.NDArray[np.bool_]:
    """Return (N,) which vertices belong to the target: the part of the fine patch that a tool from outside touches."""
    return shell.fine & (shell.normals @ shell.frame[:, 2] > UPWARD)


def inner(shell: Shell) -> npt.NDArray[np.bool_]:
    """Return (N,) which vertices of the mask are farther than BORDER_M from every vertex outside it."""
    inside = mask(shell)
    apart = np.linalg.norm(shell.vertices[:, None] - shell.vertices[~inside], axis=2).min(1)
    return inside & (apart > BORDER_M)


def random_places(shell: Shell, rng: np.random.Generator, count: int) -> Array:
    """Draw places (count, 2) [m], along and across, on the mask, at least BORDER_M from every vertex outside it."""
    far, upward, flat = inner(shell), _upward(shell), _flat(shell)
    chosen = []
    low, high = flat[mask(shell)].min(0), flat[mask(shell)].max(0)
    while len(chosen) < count:
        place = rng.uniform(low, high)
        nearest = np.where(upward, np.linalg.norm(flat - place, axis=1), np.inf).argmin()
        if far[nearest]:
            chosen.append(place)
    return np.array(chosen)


def draw(result: CheckResult, figure: Figure) -> None:
    regions = result.regions("points")
    figure.set_size_inches(max(3.4, 2.5 * len(regions)), 4.2)
    axes = figure.subplots(2, len(regions), squeeze=False)
    for (above, below), region in zip(axes.T, regions, strict=True):
        along, across, inside = result.curves[f"{region}/points"].T
        above.plot(1000 * along, 1000 * across, ".", ms=1.5, color="0.8")
        above.plot(1000 * along[inside > 0], 1000 * across[inside > 0], ".", ms=2.5, color="C5", label="target mask")
        places, force = result.curves[f"{region}/places"], result.curves[f"{region}/force"]
        above.plot(*1000 * places.T, "x", ms=4, color="C1", label="pressed")
        above.set_aspect("equal")
        above.grid(visible=False)
        above.set(xlabel="along [mm]", title=region.replace("_", " "))
        for k, depth in enumerate(DEPTHS_M):
            share = force[:, k] / force[:, k].mean()
            label = f"{1000 * depth:.0f} mm, CV {100 * share.std(ddof=1):.1f} %"
            below.plot(np.sort(share), "o-", ms=3, lw=0.7, label=label)
        below.set(xlabel="places in order of force", ylim=(0.6, 1.6))
        below.legend(loc="upper left")
    axes[0, 0].set_ylabel("across [mm]")
    axes[1, 0].set_ylabel("force / mean")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=3)

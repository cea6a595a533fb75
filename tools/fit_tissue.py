"""Fit a region's anchor law so that the shipped mesh answers the reference indenter as the reference curve says.

    python tools/fit_tissue.py paper-mapping forearm abdomen
    python tools/fit_tissue.py human-published upper_arm
    python tools/fit_tissue.py manikin-like forearm abdomen

The bone is held; a rigid indenter moves along the surface normal at 5 mm/s, as in the reference trials, at several
places of the patch (carecontact.sim.bench); (a, c) of the law a x + c x^3 per area are found by least squares on the
mean curve. Prints the row for the set's file under src/carecontact/protocols/tissue. ``--check`` reports the shipped
numbers at those places; ``--off-target`` fits the factor of the coarse mesh to the fine one's answer to the tool.

The human references are carecontact.validation.reference's; the manikin-like curves are assumed.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from carecontact.contract.protocol import Tissue
from carecontact.protocols.tissue_sets import load_tissue_set, shipped_tissue_sets
from carecontact.sim.bench import LAW_FIELDS, Bench, Indenter
from carecontact.validation.reference import ABDOMEN, FOREARM, UPPER_ARM_ANTERIOR, Reference
from carecontact.world.human.body import Body
from carecontact.world.human.library import load_body
from carecontact.world.scene import off_target

SPEED_M_S = 0.005
TOOL_DEPTH_M = np.arange(1, 13) * 0.0005
Places = list[tuple[float, float]]
PLACES: dict[str, Places] = {
    "forearm": [(-0.035, -0.006), (-0.035, 0.006), (0.0, -0.004), (0.0, 0.004), (0.032, -0.004), (0.032, 0.006)],
    "upper_arm": [(-0.035, -0.006), (-0.035, 0.006), (0.0, -0.004), (0.0, 0.004), (0.032, -0.004), (0.032, 0.006)],
    "abdomen": [(x, y) for x in (-0.04, 0.0, 0.04) for y in (-0.05, 0.0, 0.05)],
}
"""(along, across) of the region's frame [m]; the validation's held-out places keep 8 mm from them."""


@dataclass(frozen=True)
class Curve:
    depth_m: np.ndarray
    force_n: np.ndarray
    indenter: Indenter


def quadratic(a: float, b: float, depth_mm: float, indenter: Indenter) -> Curve:
    """F = a d + b d^2 [N, mm]."""
    depth = np.linspace(0.0, depth_mm, 13)[1:]
    return Curve(depth / 1000, a * depth + b * depth**2, indenter)


def published(reference: Reference) -> Curve:
    return Curve(reference.depth_m[1:], reference.force_n[1:], reference.indenter)


CURVES = {
    ("paper-mapping", "forearm"): published(FOREARM),
    ("paper-mapping", "abdomen"): published(ABDOMEN),
    ("human-published", "forearm"): published(FOREARM),
    ("human-published", "upper_arm"): published(UPPER_ARM_ANTERIOR),
    ("human-published", "abdomen"): published(ABDOMEN),
    ("manikin-like", "forearm"): quadratic(2.0, 0.08, 6.0, FOREARM.indenter),
    ("manikin-like", "abdomen"): quadratic(0.8, 0.04, 12.0, ABDOMEN.indenter),
}


def off_target_scale(body: Body, region: str, tissue: Tissue) -> float:
    """Factor on the anchor law of the coarse mesh so that the shipped tool meets the fine mesh's mean curve to 6 mm."""
    tool, places = Indenter(shape="cap"), PLACES[region]

    def mean(bench: Bench) -> np.ndarray:
        return np.mean([bench.response(TOOL_DEPTH_M, along_m=x, across_m=y, speed_m_s=0.02) for x, y in places], 0)

    wanted = mean(Bench(body=body, region=region, tissue=tissue, indenter=tool))
    unscaled = off_target(tissue.model_copy(update={"off_target_scale": 1.0}))
    bench = Bench(body=body, region=region, tissue=unscaled, indenter=tool)
    scale, got = tissue.off_target_scale, wanted
    for _ in range(6):
        bench.set_law(unscaled.model_copy(update={name: scale * getattr(unscaled, name) for name in LAW_FIELDS}))
        got = mean(bench)
        scale *= float(wanted @ wanted / (got @ wanted))
    print(f"off_target_scale = {scale:.3f}")
    print(f"# tool at 2, 4, 6 mm: fine {wanted[3::4].round(2)} N, coarse {got[3::4].round(2)} N")
    return scale


def fit(body: Body, region: str, tissue: Tissue, curve: Curve, *, check: bool) -> None:
    bench = Bench(body=body, region=region, tissue=tissue, indenter=curve.indenter)

    def forces(p: np.ndarray) -> np.ndarray:
        law = {"a_n_m3": float(np.exp(p[0])), "b_n_m4": 0.0, "c_n_m5": float(np.exp(p[1]))}
        bench.set_law(tissue.model_copy(update=law))
        return np.array(
            [bench.response(curve.depth_m, along_m=x, across_m=y, speed_m_s=SPEED_M_S) for x, y in PLACES[region]]
        )

    p = np.log([tissue.a_n_m3, max(tissue.c_n_m5, 1e6)])
    if not check:
        bounds = np.log([[1e4, 1e6], [1e8, 1e13]])
        p = least_squares(
            lambda p: (forces(p).mean(0) - curve.force_n) / curve.force_n.max(), p, bounds=bounds, diff_step=0.02,
            xtol=1e-3, ftol=1e-4, max_nfev=15,
        ).x  # fmt: skip
    got, most = forces(p), curve.force_n.max()
    mean = np.sqrt(np.mean((got.mean(0) - curve.force_n) ** 2)) / most
    each = np.sqrt(np.mean((got - curve.force_n) ** 2, axis=1)) / most
    print(f"a_n_m3 = {np.exp(p[0]):.4g}\nc_n_m5 = {np.exp(p[1]):.3g}")
    # Three times critical per area; see world.human.tissue.
    print(f"damping_ns_m3 = {6 * np.sqrt(np.exp(p[0]) * tissue.areal_mass_kg_m2):.3g}")
    reached = [
        bench.press(depth_m=float(curve.depth_m[-1]), along_m=x, across_m=y, speed_m_s=SPEED_M_S).anchor_m.max()
        for x, y in PLACES[region]
    ]
    print(f"measured_depth_m = {np.mean(reached):.4f}")
    print(f"# NRMSE of the mean curve {mean:.1%}, of single places {each.min():.1%} to {each.max():.1%}")
    for k in range(0, len(curve.depth_m), 3):
        print(f"#  {1000 * curve.depth_m[k]:5.2f} mm  wanted {curve.force_n[k]:6.2f} N  got {got.mean(0)[k]:6.2f} N")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("tissue_set", choices=shipped_tissue_sets())
    parser.add_argument("regions", nargs="+", choices=["forearm", "upper_arm", "abdomen"])
    parser.add_argument("--body", default="man-adult")
    parser.add_argument("--check", action="store_true", help="report the shipped numbers without fitting")
    parser.add_argument("--off-target", action="store_true", help="fit the coarse mesh to the fine one with the tool")
    arguments = parser.parse_args()
    body, rows = load_body(arguments.body), load_tissue_set(arguments.tissue_set).tissue
    for region in arguments.regions:
        print(f"[{region}]")
        if arguments.off_target:
            off_target_scale(body, region, rows[region])
            continue
        curve = CURVES.get((arguments.tissue_set, region))
        if curve is None:
            parser.error(f"{arguments.tissue_set} takes its {region} from another region; nothing to fit")
        fit(body, region, rows[region], curve, check=arguments.check)


if __name__ == "__main__":
    main()

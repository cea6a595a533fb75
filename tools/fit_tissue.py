"""Fit a region's anchor law so that the shipped mesh answers the reference indenter as the reference curve says.

    python tools/fit_tissue.py forearm abdomen

The bone is held; a rigid indenter moves along the outward axis at 5 mm/s at three places of the patch; (a, c) of the
law a x + c x^3 per area are found by least squares on the mean curve. Prints the rows for the protocol file.

References (loading only; limb secants are measured, their curvature is inferred from two R-squared values):
  forearm  F = 0.862 d + 0.073 d^2, flat 360 mm^2 probe, to 4.5 mm: derived from MULTIS (Neumann et al. 2018,
           Sci Data 5:180193), anterior forearm.
  abdomen  F = 0.1665 d + 0.00873 d^2, hemisphere of 10 mm radius, to 23 mm: Remus et al. 2024,
           Front Bioeng Biotechnol 12:1384062.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np
from scipy.optimize import least_squares

from carecontact.contract.protocol import Tissue
from carecontact.protocols import load_protocol
from carecontact.world.human.body import Body, load_body
from carecontact.world.human.shell import Shell, limb_shell, trunk_shell
from carecontact.world.human.skeleton import SOFT_SEGMENTS, body_name, tissue_body_name
from carecontact.world.human.tissue import add_tissue, set_damping
from carecontact.world.robot import CAP_HALF_WIDTH_M, CAP_RADIUS_M
from carecontact.world.scene import off_target, upward_in_bind

SPEED_M_S = 0.005
PROBE_RADIUS_M = 0.0107  # of the disc of 360 mm^2
EDGE_M = 0.002  # rounded: sharp flat indenters let rim vertices slip


@dataclass(frozen=True)
class Reference:
    curve: Callable[[np.ndarray], np.ndarray]
    depth_mm: float
    indenter: str


REFERENCES = {
    "forearm": Reference(lambda d: 0.862 * d + 0.073 * d**2, 4.5, "flat"),
    "upper_arm": Reference(lambda d: 0.862 * d + 0.073 * d**2, 4.5, "flat"),
    "abdomen": Reference(lambda d: 0.1665 * d + 0.00873 * d**2, 23.0, "hemisphere"),
}


def press_curves(
    region: str, shell: Shell, tissue: Tissue, reference: Reference, places: list[tuple[float, float]]
) -> np.ndarray:
    """(places, n) force [N] at depths 0.25 mm apart."""
    body = load_body("man-adult")
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    spec.option.impratio = 10
    spec.option.timestep = 0.002
    spec.option.gravity = [0, 0, 0]
    segment = SOFT_SEGMENTS[region]
    bone = spec.worldbody.add_body(name=body_name(segment))
    bone.add_body(name=tissue_body_name(region))
    made = add_tissue(spec, body, region, shell, tissue)
    probe = spec.worldbody.add_body(name="probe", mocap=True)
    common = dict(contype=1, conaffinity=0, condim=3)
    if reference.indenter == "cap":  # the shipped tool, lying across the limb
        probe.add_geom(
            type=mujoco.mjtGeom.mjGEOM_CAPSULE, size=[CAP_RADIUS_M, 0, 0], **common,
            fromto=[0, -CAP_HALF_WIDTH_M, CAP_RADIUS_M, 0, CAP_HALF_WIDTH_M, CAP_RADIUS_M],
        )  # fmt: skip
    elif reference.indenter == "hemisphere":
        probe.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.010, 0, 0], pos=[0, 0, 0.010], **common)
    else:
        ring = np.linspace(0, 2 * np.pi, 24, endpoint=False)
        rims = [
            (PROBE_RADIUS_M - EDGE_M * (1 - np.sin(s)), EDGE_M * (1 - np.cos(s))) for s in np.linspace(0, np.pi / 2, 5)
        ]
        points = [[r * np.cos(a), r * np.sin(a), h] for r, h in rims for a in ring]
        points += [[PROBE_RADIUS_M * np.cos(a), PROBE_RADIUS_M * np.sin(a), 0.03] for a in ring]
        spec.add_mesh(name="flat", uservert=np.array(points).ravel())
        probe.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname="flat", **common)
    spec.add_sensor(
        name="force", type=mujoco.mjtSensor.mjSENS_CONTACT, objtype=mujoco.mjtObj.mjOBJ_XBODY, objname="probe",
        reftype=mujoco.mjtObj.mjOBJ_XBODY, refname=body_name(segment), intprm=[2, 3, 1],
    )  # fmt: skip
    model = spec.compile()
    set_damping(model, {region: made})
    x, y, z = shell.frame.T
    at = body.joint_centre[segment]
    quat = np.zeros(4)
    grid = np.arange(0.25, reference.depth_mm + 1e-9, 0.25)
    curves = []
    for along, across in places:
        data = mujoco.MjData(model)
        foot = shell.frame_origin + along * x + across * y
        # Surface point under the probe: the nearest shell vertex in the plane of x and y; its normal is the direction.
        flat = (shell.vertices - foot) @ np.stack([x, y], 1)
        k = int(np.where(shell.normals @ z > 0.3, np.linalg.norm(flat, axis=1), np.inf).argmin())
        top, normal = shell.vertices[k] - at, shell.normals[k]
        frame = np.stack([np.cross(x - (x @ normal) * normal, -normal), np.zeros(3), normal], 1)
        frame[:, 0] = x - (x @ normal) * normal
        frame[:, 0] /= np.linalg.norm(frame[:, 0])
        frame[:, 1] = np.cross(normal, frame[:, 0])
        mujoco.mju_mat2Quat(quat, frame.ravel())
        depth, force = [], []
        start = 0.004
        steps = int((start + reference.depth_mm / 1000 + 0.002) / SPEED_M_S / model.opt.timestep)
        for step in range(steps):
            travel = SPEED_M_S * step * model.opt.timestep - start
            data.mocap_pos[0], data.mocap_quat[0] = top - travel * normal, quat
            mujoco.mj_step(model, data)
            depth.append(travel * 1000)
            force.append(float(np.linalg.norm(data.sensordata)))
        depth, force = np.array(depth), np.array(force)
        touch = np.argmax(force > 0.02)
        curves.append(np.interp(grid, depth - depth[touch], force))
    return np.array(curves)


def make_shell(body: Body, region: str, tissue: Tissue) -> Shell:
    segment = SOFT_SEGMENTS[region]
    if region == "abdomen":
        return trunk_shell(body, np.array([0.0, -1, 0]), tissue)
    return limb_shell(body, segment, upward_in_bind(body, segment), tissue)


def fit_off_target(region: str, tissue: Tissue, places: list[tuple[float, float]]) -> float:
    """Factor on the anchor law of the coarse mesh so that the shipped tool meets the fine mesh's mean curve to 6 mm."""
    body, tool = load_body("man-adult"), Reference(lambda d: d, 6.0, "cap")
    wanted = press_curves(region, make_shell(body, region, tissue), tissue, tool, places).mean(0)

    def force(scale: float) -> np.ndarray:
        coarse = off_target(tissue.model_copy(update={"off_target_scale": scale}))
        return press_curves(region, make_shell(body, region, coarse), coarse, tool, places).mean(0)

    scale = tissue.off_target_scale
    for _ in range(6):
        scale *= float(wanted @ wanted / (force(scale) @ wanted))
    got = force(scale)
    print(f"{region}: off_target_scale = {scale:.3f}")
    print(f"  tool at 2 / 4 / 6 mm: fine {wanted[[7, 15, 23]].round(2)} N, coarse {got[[7, 15, 23]].round(2)} N")
    return scale


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("regions", nargs="+", choices=sorted(REFERENCES))
    parser.add_argument("--check", action="store_true", help="report the shipped numbers without fitting")
    parser.add_argument("--off-target", action="store_true", help="fit the coarse mesh to the fine one with the tool")
    arguments = parser.parse_args()
    protocol, body = load_protocol(), load_body("man-adult")
    for region in arguments.regions:
        tissue, reference = protocol.person.tissue[region], REFERENCES[region]
        shell = make_shell(body, region, tissue)
        spread = 0.03 if region == "abdomen" else 0.012
        places = [(0.0, 0.0), (0.031, spread / 2), (-0.037, -spread)]
        grid = np.arange(0.25, reference.depth_mm + 1e-9, 0.25)
        wanted = reference.curve(grid)

        if arguments.off_target:
            fit_off_target(region, tissue, places)
            continue

        def law(p: np.ndarray, tissue: Tissue = tissue) -> Tissue:
            return tissue.model_copy(
                update={"a_n_m3": float(np.exp(p[0])), "b_n_m4": 0.0, "c_n_m5": float(np.exp(p[1]))}
            )

        def residual(
            p: np.ndarray, region=region, shell=shell, reference=reference, places=places, wanted=wanted
        ) -> np.ndarray:
            return (press_curves(region, shell, law(p), reference, places).mean(0) - wanted) / wanted.max()

        p = np.log([tissue.a_n_m3, max(tissue.c_n_m5, 1.0)])
        if not arguments.check:
            p = least_squares(residual, p, diff_step=0.004, xtol=1e-4, ftol=1e-4, max_nfev=20).x
        curves = press_curves(region, shell, law(p), reference, places)
        error = np.sqrt(np.mean((curves.mean(0) - wanted) ** 2)) / wanted.max()
        each = np.sqrt(np.mean((curves - wanted) ** 2, axis=1)) / wanted.max()
        held = press_curves(region, shell, law(p), reference, [(0.015, -spread / 2), (-0.02, spread * 0.8)])
        out = np.sqrt(np.mean((held - wanted) ** 2, axis=1)) / wanted.max()
        print(f"{region}: a_n_m3 = {np.exp(p[0]):.4g}  c_n_m5 = {np.exp(p[1]):.4g}")
        print(
            f"  NRMSE mean curve {error:.1%}; per place {np.round(each * 100, 1)} %; "
            f"held-out places {np.round(out * 100, 1)} %"
        )
        for d, w, c in list(zip(grid, wanted, curves.mean(0), strict=True))[3 :: max(1, len(grid) // 8)]:
            print(f"  {d:5.2f} mm  wanted {w:6.2f} N  got {c:6.2f} N")


if __name__ == "__main__":
    main()

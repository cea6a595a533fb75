"""The statements of a certificate that need no fit, so that ``verify`` can compute them again."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np

from carecontact.calibration.agreement import tangent
from carecontact.calibration.certificate import Response
from carecontact.calibration.checks import TrialFile
from carecontact.calibration.curve import GRID, Curve, plateau_m
from carecontact.calibration.replay import Group, Replay, Replayed
from carecontact.contract.protocol import Tissue
from carecontact.protocols.tissue_sets import load_tissue_set
from carecontact.sim.bench import LAW_FIELDS
from carecontact.world.human.build import tissue_of
from carecontact.world.human.library import load_body

PUBLISHED_SET = "human-published"


def measured_facts(file: TrialFile, curves: Sequence[Curve]) -> dict[str, Any]:
    """Return the statements about the data alone, by the names of Content's fields."""
    return {
        "synthetic": all("synthetic" in trial.site.lower() for trial in file.trials),
        "trials": len(curves),
        "subjects": len({trial.subject for trial in file.trials}),
        "measured_depth_mm": 1000 * float(np.median([curve.deepest_m for curve in curves])),
        "measured_force_n": float(np.median([curve.peak_n for curve in curves])),
        "plateaus": {curve.trial.trial_id: 1000 * depth for curve in curves if (depth := plateau_m(curve)) is not None},
        "measured_stiffness": {
            "secant_n_mm": float(np.mean([c.peak_n / c.deepest_m / 1000 for c in curves])),
            "tangent_n_mm": float(np.mean([tangent(c.grid_m, c.loading_n) / 1000 for c in curves])),
        },
    }


def simulated_stiffness(groups: Sequence[Group], replayed: Sequence[Replayed]) -> dict[str, float]:
    """Return the secant stiffness to the deepest point and the tangent stiffness over the deeper half [N/mm], each as
    the mean over all trials.
    """
    weight = np.array([len(g.members) for g in groups], float)
    secants = [one.loading_n[-1] / g.deepest_m / 1000 for g, one in zip(groups, replayed, strict=True)]
    tangents = [tangent(GRID * g.deepest_m, one.loading_n) / 1000 for g, one in zip(groups, replayed, strict=True)]
    return {
        "secant_n_mm": float(np.average(secants, weights=weight)),
        "tangent_n_mm": float(np.average(tangents, weights=weight)),
    }


def published_ratio(replay: Replay, curves: Sequence[Curve]) -> float:
    """Return the measured peak force over that of published tissue, pressed as deep and as fast; median of the trials.

    It has the mesh and the contact layer of the replays, and the law of the shipped set ``human-published``, or the
    protocol's where that set has no row of the region.
    """
    row, region, body = replay.tissue, replay.region, replay.body
    published = load_tissue_set(PUBLISHED_SET).tissue
    if region in published:
        law = tissue_of(body, region, published[region])
        row = row.model_copy(update={name: getattr(law, name) for name in LAW_FIELDS})
    ratios = []
    for group in replay.groups:
        bench = replay.bench_of(group)
        bench.set_law(row)
        c = group.condition
        press = bench.press(
            along_m=c.along_m, across_m=c.across_m, tilt_deg=c.tilt_deg, depth_m=group.deepest_m, speed_m_s=c.speed_m_s
        )
        ratios += [curves[k].peak_n / float(press.force_n.max()) for k in group.members]
    return float(np.median(ratios))


def responses(curves: Sequence[Curve], groups: Sequence[Group], replayed: Sequence[Replayed]) -> list[Response]:
    """Return the replayed forces of every group, rounded as a certificate stores them."""
    return [
        Response(
            trials=[curves[k].trial.trial_id for k in group.members],
            speed_mm_s=1000 * group.condition.speed_m_s,
            along_mm=1000 * group.condition.along_m,
            across_mm=1000 * group.condition.across_m,
            tilt_deg=group.condition.tilt_deg,
            depth_mm=[round(float(d), 4) for d in 1000 * GRID * group.deepest_m],
            loading_n=[round(float(f), 5) for f in one.loading_n],
            unloading_n=[round(float(f), 5) for f in one.unloading_n] if group.unloads else None,
        )
        for group, one in zip(groups, replayed, strict=True)
    ]


def model_hashes(replay: Replay, body: str, tissue: Tissue) -> dict[str, str]:
    """Return the sha256 of the body's archive, of the shell's mesh, and of the benches that are compiled with this
    law.
    """
    shell = next(iter(replay.benches.values())).shell
    mesh = hashlib.sha256(np.ascontiguousarray(shell.vertices).tobytes())
    mesh.update(np.ascontiguousarray(shell.triangles).tobytes())
    model = hashlib.sha256()
    for bench in replay.benches.values():
        bench.set_law(tissue)
        buffer = np.zeros(mujoco.mj_sizeModel(bench.model), np.uint8)
        mujoco.mj_saveModel(bench.model, None, buffer)
        model.update(buffer.tobytes())
    return {"body": load_body(body).sha256, "mesh": mesh.hexdigest(), "model": model.hexdigest()}

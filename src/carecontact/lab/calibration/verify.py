"""Runs a certificate's simulation again on the same data: the statements that need no fit, and whether the results are
the same."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from carecontact.errors import ConfigError
from carecontact.human.library import load_body
from carecontact.human.soft_region import tissue_of
from carecontact.lab.calibration.certificate import BAND, LIMITS, Certificate, Content, Response, Value, reasons
from carecontact.lab.calibration.checks import TrialFile, read_trials
from carecontact.lab.calibration.curve import GRID, Curve, make_curve, plateau_m
from carecontact.lab.calibration.problem import POOLED, agreements, pooled, tangent
from carecontact.lab.calibration.replay import Group, Replay, Replayed, group_curves
from carecontact.protocol.overrides import load_tissue_set
from carecontact.protocol.person import Tissue
from carecontact.sim.bench import LAW_FIELDS
from carecontact.tissue.binary_lookup import binary_sha256 as kernel_sha256

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
    """Return the mean secant stiffness to the deepest point and tangent stiffness over the deeper half [N/mm]."""
    weight, pairs = [len(g.members) for g in groups], list(zip(groups, replayed, strict=True))
    secants = [one.loading_n[-1] / g.deepest_m / 1000 for g, one in pairs]
    tangents = [tangent(GRID * g.deepest_m, one.loading_n) / 1000 for g, one in pairs]
    means = {"secant_n_mm": secants, "tangent_n_mm": tangents}
    return {name: float(np.average(values, weights=np.array(weight, float))) for name, values in means.items()}


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
    """Return the sha256 of the body's archive, of the shell's mesh, and of the benches compiled with this law."""
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


@dataclass(frozen=True, kw_only=True)
class Check:
    name: str
    certified: str
    here: str
    fine: bool
    decides: bool = True
    """Whether the check decides. One that does not is only shown, since another version may give the same forces."""


def verify(trials: Sequence[Path], certificate: Certificate) -> list[Check]:
    """Compute the facts about the data and the forces of the law again. Returns the checks, the deciding ones first.

    Held-out errors, intervals and the identified formulas are not computed again, which would need the fit; the verdict
    must follow from those that the certificate states.

    Raises ConfigError if the data are not the certificate's or the certificate contradicts itself. A certificate's hash
    shows that it was not changed by accident, but not who wrote it.
    """
    content = certificate.content
    _check_consistent(content)
    file = read_trials(trials, region=content.region, setup=content.setup)
    if file.sha256 != content.hashes["data"]:
        raise ConfigError(
            f"{', '.join(map(str, trials))}: sha256 {file.sha256[:12]}..., the certificate was made from "
            f"{content.hashes['data'][:12]}...; verify with the same file{'s' * (len(trials) > 1)}"
        )
    curves = [make_curve(trial) for trial in file.trials]
    groups = group_curves(curves)
    if [[curves[k].trial.trial_id for k in g.members] for g in groups] != [one.trials for one in content.responses]:
        raise ConfigError(
            f"the trials make {len(groups)} presses here, the certificate has {len(content.responses)} of other "
            "trials: it was made by another carecontact version"
        )
    _check_facts(content, measured_facts(file, curves))
    replay = Replay(body=load_body(content.body), region=content.region, tissue=content.tissue, groups=groups)
    hashes = model_hashes(replay, content.body, content.tissue)
    if hashes["body"] != content.hashes["body"]:
        raise ConfigError(
            f"the certificate was made with another {content.body}: sha256 {content.hashes['body'][:12]}..., here "
            f"{hashes['body'][:12]}...; verify with the body file that the certificate was made with"
        )
    return [*_check_replay(content, curves, groups, replay), *_show_versions(content, hashes)]


def _check_replay(
    content: Content, curves: Sequence[Curve], groups: Sequence[Group], replay: Replay
) -> Iterator[Check]:
    # The row differs from the fitted one only in measured_depth and source; its law is the certificate's.
    replayed = [one for one in replay.run(content.tissue) if one is not None]
    allowed, change = BAND["response_share_of_peak"], BAND["error_change"]
    worst = _largest_difference(responses(curves, groups, replayed), content.responses)
    yield Check(name="response", certified=f"within {allowed:.1%} of peak", here=f"{worst:.3%}", fine=worst <= allowed)
    errors = pooled(agreements(curves, groups, replayed))
    for name, stated in content.agreement.items():
        yield _check_value(name, stated, errors[name], allowed=change, band=f"{change:.0%}", style="+.2%")
    ratio = Value(value=content.published_ratio, ci95=None)
    here = published_ratio(replay, curves)
    yield _check_value("times published", ratio, here, allowed=allowed * here, band=f"{allowed:.1%}", style=".3g")
    for name, here in simulated_stiffness(groups, replayed).items():
        stated = content.stiffness[name]
        yield _check_value(name, stated, here, allowed=allowed * abs(here), band=f"{allowed:.1%}", style=".3f")


def _largest_difference(here: Sequence[Response], certified: Sequence[Response]) -> float:
    """Return the largest difference of the replayed forces, as a share of the certified peak."""
    worst = 0.0
    for mine, theirs in zip(here, certified, strict=True):
        if [len(mine.loading_n), mine.unloading_n is None] != [len(theirs.loading_n), theirs.unloading_n is None]:
            raise ConfigError(f"response of {', '.join(theirs.trials)}: {len(mine.loading_n)} depths expected")
        peak = theirs.loading_n[-1]
        for a, b in ((mine.loading_n, theirs.loading_n), (mine.unloading_n, theirs.unloading_n)):
            if a is not None and b is not None:
                # np.maximum passes a NaN on, and a NaN is not within any limit.
                worst = float(np.maximum(worst, np.abs(np.subtract(a, b)).max() / peak))
    return worst


def _check_value(name: str, stated: Value, here: float | None, *, allowed: float, band: str, style: str) -> Check:
    certified, now = ("none" if value is None else format(value, style) for value in (stated.value, here))
    if stated.value is None or here is None:
        fine = stated.value is here
    else:
        fine = abs(stated.value - here) <= allowed
    return Check(name=name, certified=f"{certified} +- {band}", here=now, fine=fine)


def _show_versions(content: Content, hashes: dict[str, str]) -> Iterator[Check]:
    pairs = {
        "mujoco": (content.versions["mujoco"], version("mujoco")),
        "kernel": (content.versions["kernel"], kernel_sha256()),
    }
    pairs |= {name: (content.hashes[name], hashes[name]) for name in ("mesh", "model")}
    for name, (certified, here) in pairs.items():
        yield Check(name=name, certified=certified[:12], here=here[:12], fine=certified == here, decides=False)


def _check_facts(content: Content, facts: dict[str, object]) -> None:
    """Raise ConfigError if the data contradict a statement of the certificate about them."""
    for name, here in facts.items():
        stated = getattr(content, name)
        if isinstance(here, dict):
            same = stated.keys() == here.keys() and all(np.isclose(stated[k], v, rtol=1e-6) for k, v in here.items())
        else:
            same = bool(np.isclose(stated, here, rtol=1e-6)) if isinstance(here, float) else stated == here
        if not same:
            raise ConfigError(f"the certificate states {name} {stated}, its data give {here}")
    # Contact acts on the middles of triangles, and a vertex may lie a little deeper than they do.
    if not 0 < content.tissue.measured_depth_m <= 1.1 * content.measured_depth_mm / 1000:
        raise ConfigError(
            f"the certificate's row has measured_depth_m {content.tissue.measured_depth_m:g}, but no anchor went "
            f"deeper than the indenter, {content.measured_depth_mm:.3g} mm"
        )
    if content.gate_is_extrapolated != (content.gate_n > content.measured_force_n):
        raise ConfigError(
            f"the certificate says that the safety gate of {content.gate_n:g} N is "
            f"{'' if content.gate_is_extrapolated else 'not '}extrapolated, but {content.measured_force_n:.3g} N were "
            "measured"
        )


def _check_consistent(content: Content) -> None:
    """Raise ConfigError if the row has another law than stated, the band is not BAND, or something is missing."""
    for name, stated in content.law.items():
        row = getattr(content.tissue, name, None)
        if stated.value is not None and stated.value != row:
            raise ConfigError(f"the certificate states {name} {stated.value:g}, its tissue row has {row}")
    if content.band != BAND:
        raise ConfigError(f"the certificate allows {content.band}; this carecontact allows {BAND}")
    for of in (content.agreement, content.held_out):
        if of is not None and (set(of) != set(POOLED) or of["nrmse"].value is None):
            raise ConfigError(f"the certificate's agreement has {sorted(of)}; expected {sorted(POOLED)}")
    if set(content.stiffness) != {"secant_n_mm", "tangent_n_mm"}:
        raise ConfigError(f"the certificate's stiffness has {sorted(content.stiffness)}")
    if missing := {"data", "body", "mesh", "model"} - set(content.hashes):
        raise ConfigError(f"the certificate has no hash of: {', '.join(sorted(missing))}")
    for name in ("mujoco", "kernel"):
        if name not in content.versions:
            raise ConfigError(f"the certificate does not name the {name} that made it")
    why, row = reasons(content), content.tissue.calibration
    if content.limits != LIMITS:
        raise ConfigError(f"the certificate accepts errors up to {content.limits}; this carecontact up to {LIMITS}")
    if content.reasons != why or (content.verdict == "rejected") != bool(why):
        raise ConfigError(f"the certificate says {content.verdict}, its own figures: {'; '.join(why) or 'accepted'}")
    if row is None or row.verdict != content.verdict:
        verdict = "nothing" if row is None else row.verdict
        raise ConfigError(f"the certificate says {content.verdict}, its tissue row {verdict}")

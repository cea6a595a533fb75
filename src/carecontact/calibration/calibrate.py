"""From a trials file to a certificate, a tissue row and a figure; and the same simulation again, to verify."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from carecontact import __version__
from carecontact.calibration.agreement import Agreement, pooled, tangent
from carecontact.calibration.certificate import (
    Certificate,
    Content,
    Model,
    Response,
    Value,
    tissue_set_toml,
    write_certificate,
)
from carecontact.calibration.checks import TrialFile, read_trials
from carecontact.calibration.curve import GRID, Curve, make_curve
from carecontact.calibration.figure import write_figure
from carecontact.calibration.fit import BOOTSTRAP_SEED, BOOTSTRAPS, DAMPING, LAW, Fit, fit_law
from carecontact.calibration.identify import Identified, identify
from carecontact.calibration.replay import Group, Replay, Replayed, group_curves
from carecontact.contract.protocol import Protocol, Tissue
from carecontact.errors import ConfigError
from carecontact.protocols import FAST_DT_S, load_protocol
from carecontact.world.human.library import load_body
from carecontact.world.human.tissue import check_step

CERTIFICATE, ROW, FIGURE = "certificate.json", "tissue.toml", "calibration.png"
BAND = {"response_share_of_peak": 0.02, "error_change": 0.01}
"""--verify fails where a replayed force differs by more than this share of its peak, or an error by this much."""


@dataclass(frozen=True, kw_only=True)
class Calibration:
    certificate: Certificate
    written: tuple[Path, ...]


def calibrate(
    trials: Path, *, region: str, body: str, protocol: str, out: Path, on_progress: Callable[[str], None]
) -> Calibration:
    """Read, identify, fit, write. Raises ConfigError for what the user can mend."""
    rules = load_protocol(protocol)
    file = read_trials(trials, region=region)
    curves = [make_curve(trial) for trial in file.trials]
    row = _row(rules, region)
    for curve in curves:
        if curve.deepest_m > row.thickness_m:
            raise ConfigError(
                f"trial {curve.trial.trial_id!r} presses {1000 * curve.deepest_m:.3g} mm deep, the tissue over the "
                f"{region}'s bone is {1000 * row.thickness_m:g} mm: is indentation_mm in millimetres, inward?"
            )
    on_progress(f"{_count(curves)} of the {region}")
    laws = identify(curves)
    groups = group_curves(curves)
    on_progress(f"identified: {laws[0].law.name}; {len(groups)} presses to replay")
    replay = Replay(body=load_body(body), region=region, tissue=row, groups=groups)
    fit = fit_law(curves, replay=replay, on_progress=on_progress)
    content = _content(file, curves, laws, groups, replay, fit, region=region, body=body, rules=rules)
    out.mkdir(parents=True, exist_ok=True)
    paths = tuple(out / name for name in (CERTIFICATE, ROW, FIGURE))
    certificate = write_certificate(paths[0], content, made=datetime.now(UTC).isoformat(timespec="seconds"))
    synthetic = "synthetic " if content.synthetic else ""
    paths[1].write_text(
        tissue_set_toml(
            region,
            content.tissue,
            base=content.base_tissue_set,
            description=f"The {region.replace('_', ' ')} calibrated to {_count(curves, synthetic)}; "
            f"certificate {certificate.sha256[:12]}.",
            digest=certificate.sha256,
        ),
        encoding="utf-8",
    )
    held = content.held_out
    told = f", held-out NRMSE {held['nrmse'].value:.1%}" if held and held["nrmse"].value is not None else ""
    write_figure(
        paths[2], title=f"{region}, {body}: {_count(curves, synthetic)}{told}", curves=curves, groups=groups,
        replayed=fit.replayed, identified=laws[0], extrapolated_mm=content.measured_depth_mm,
    )  # fmt: skip
    return Calibration(certificate=certificate, written=paths)


def _count(curves: Sequence[Curve], kind: str = "") -> str:
    return f"{len(curves)} {kind}trial{'s' * (len(curves) != 1)}"


def _row(rules: Protocol, region: str) -> Tissue:
    rows: dict[str, Tissue] = {**rules.person.tissue}
    return rows[region]


def _content(
    file: TrialFile, curves: Sequence[Curve], laws: Sequence[Identified], groups: Sequence[Group], replay: Replay,
    fit: Fit, *, region: str, body: str, rules: Protocol,
) -> Content:  # fmt: skip
    facts = measured_facts(file, curves)
    depth, force = facts["measured_depth_mm"] / 1000, facts["measured_force_n"]
    gate = rules.limits.gamma * rules.f_pain(region)
    kind = "synthetic " if facts["synthetic"] else ""
    source = f"carecontact calibrate, {_count(curves, kind)}, data sha256 {file.sha256[:12]}"
    # Results count how deep anchors go, not how far the tool travels.
    reached = np.repeat([one.press.anchor_m.max() for one in fit.replayed], [len(g.members) for g in groups])
    tissue = fit.tissue.model_copy(update={"measured_depth_m": float(np.median(reached)), "source": source})
    law, notes = _law_values(fit), list(file.notes)
    if len(curves) == 1:
        notes.append("a single trial: no intervals, damping's neither, no held-out error; record at least five")
    if not fit.damping_identified:
        notes.append(f"damping is not identified ({fit.damping_reason}): the row keeps the ratio of D_c to stiffness")
    notes += hardly_identified(law)
    if gate > force:
        notes.append(f"beyond {1000 * depth:.1f} mm or {force:.1f} N the row extrapolates; the gate is {gate:g} N")
    for dt in (rules.physics.dt_s, FAST_DT_S):
        try:
            check_step(region, next(iter(replay.benches.values())).shell, tissue, dt)
        except ConfigError as error:
            # Worth knowing, and no reason to lose the fit.
            notes.append(f"a run at {1000 * dt:g} ms will refuse this row: {error}")
    notes.append("off_target_scale and thickness are those of the protocol's row, not calibrated")
    stiffness = {}
    for k, (name, mean) in enumerate(simulated_stiffness(groups, fit.replayed).items()):
        interval = None
        if fit.secant_draws is not None:
            low, high = np.percentile(fit.secant_draws[:, k], [2.5, 97.5])
            interval = (mean * (1 + float(low)), mean * (1 + float(high)))
        stiffness[name] = Value(value=mean, ci95=interval)
    return Content(
        region=region,
        body=body,
        base_tissue_set=rules.person.tissue_set,
        tissue=tissue,
        law=law,
        damping=fit.damping_reason,
        stiffness=stiffness,
        identified=[
            Model(
                name=one.law.name, formula=one.law.formula, parameters=one.physical(), rms=one.rms, aicc=one.aicc,
                left_out_rms=one.left_out_rms,
            ) for one in laws
        ],
        agreement=_values(fit.agreement),
        held_out=None if fit.held_out is None else _values(fit.held_out),
        **facts,
        gate_n=gate,
        gate_is_extrapolated=gate > force,
        responses=responses(curves, groups, fit.replayed),
        band=BAND,
        hashes={"data": file.sha256, **model_hashes(replay, body, tissue)},
        versions={"carecontact": __version__, "mujoco": version("mujoco"), "protocol": rules.id},
        notes=notes,
    )  # fmt: skip


def measured_facts(file: TrialFile, curves: Sequence[Curve]) -> dict[str, Any]:
    """What a certificate says of its data alone, as the fields of Content."""
    return {
        "synthetic": all("synthetic" in trial.site.lower() for trial in file.trials),
        "trials": len(curves),
        "subjects": len({trial.subject for trial in file.trials}),
        "measured_depth_mm": 1000 * float(np.median([curve.deepest_m for curve in curves])),
        "measured_force_n": float(np.median([curve.peak_n for curve in curves])),
        "measured_stiffness": {
            "secant_n_mm": float(np.mean([c.peak_n / c.deepest_m / 1000 for c in curves])),
            "tangent_n_mm": float(np.mean([tangent(c.grid_m, c.loading_n) / 1000 for c in curves])),
        },
    }


def simulated_stiffness(groups: Sequence[Group], replayed: Sequence[Replayed]) -> dict[str, float]:
    """Secant to the deepest point and tangent over the deeper half [N/mm], means over trials."""
    weight = np.array([len(g.members) for g in groups], float)
    secants = [one.loading_n[-1] / g.deepest_m / 1000 for g, one in zip(groups, replayed, strict=True)]
    tangents = [tangent(GRID * g.deepest_m, one.loading_n) / 1000 for g, one in zip(groups, replayed, strict=True)]
    return {
        "secant_n_mm": float(np.average(secants, weights=weight)),
        "tangent_n_mm": float(np.average(tangents, weights=weight)),
    }


def responses(curves: Sequence[Curve], groups: Sequence[Group], replayed: Sequence) -> list[Response]:
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
    """Of the body's archive, the shell's vertices and triangles, and the benches as compiled with this law."""
    import mujoco

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


LOOSE = 4.0
"""A parameter whose interval spans more than this factor is called hardly identified."""


def hardly_identified(law: dict[str, Value]) -> list[str]:
    """A note for each stiffness parameter at its bound or with an interval wider than LOOSE."""
    said = []
    for name, one in law.items():
        if name != DAMPING and one.value == 0.0:
            said.append(f"{name} is at its bound 0: tissue that stiffens is assumed, an interval would say nothing")
        elif one.ci95 is not None and one.ci95[1] > LOOSE * max(one.ci95[0], 0.0):
            said.append(
                f"{name} is hardly identified ({one.ci95[0]:.3g} to {one.ci95[1]:.3g}): the response in the measured "
                "range is pinned down, its share in it is not; deeper is extrapolated by it"
            )
    return said


def _law_values(fit: Fit) -> dict[str, Value]:
    out = {}
    for name in (*LAW, DAMPING):
        if name == DAMPING and not fit.damping_identified:
            out[name] = Value(value=None, ci95=None)
            continue
        interval = None
        if fit.draws is not None:
            low, high = np.percentile([getattr(draw, name) for draw in fit.draws], [2.5, 97.5])
            interval = (float(low), float(high))
        value = float(getattr(fit.tissue, name))
        out[name] = Value(value=value, ci95=None if value == 0.0 else interval)
    return out


def _values(rows: Sequence[Agreement]) -> dict[str, Value]:
    """Pooled over trials, with percentile intervals over resampled trials."""
    rng = np.random.default_rng(BOOTSTRAP_SEED)
    whole = pooled(list(rows))
    draws = rng.integers(len(rows), size=(BOOTSTRAPS // 4, len(rows)))
    again = [pooled([rows[k] for k in draw]) for draw in draws] if len(rows) > 1 else []
    out = {}
    for field in fields(Agreement):
        values = [v for one in again if (v := one[field.name]) is not None]
        interval = None
        if values:
            low, high = np.percentile(values, [2.5, 97.5])
            interval = (float(low), float(high))
        out[field.name] = Value(value=whole[field.name], ci95=interval)
    return out

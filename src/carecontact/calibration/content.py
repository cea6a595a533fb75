"""The content of a certificate: the values that a calibration found, with intervals, and notes for people."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.metadata import version

import numpy as np

from carecontact import __version__
from carecontact.calibration.agreement import POOLED, Agreement, pooled
from carecontact.calibration.certificate import BAND, Content, Model, Speed, Value
from carecontact.calibration.checks import TrialFile
from carecontact.calibration.curve import Curve
from carecontact.calibration.facts import measured_facts, model_hashes, responses, simulated_stiffness
from carecontact.calibration.fit import BOOTSTRAP_SEED, BOOTSTRAPS, DAMPING, LAW, Fit
from carecontact.calibration.identify import Identified
from carecontact.calibration.replay import Replay
from carecontact.calibration.trial import Array, Setup
from carecontact.calibration.verdict import LIMITS, reasons
from carecontact.contract.protocol import Calibration, Protocol
from carecontact.kernel.found import sha256 as kernel_sha256

LEAST_DEPTH_M = 0.001
"""Least ``measured_depth_m`` that a protocol may have."""
LOOSE = 4.0
"""A parameter is called hardly identified if the ends of its interval differ by more than this factor."""


def make_content(
    file: TrialFile, curves: Sequence[Curve], laws: Sequence[Identified], replay: Replay, fit: Fit, *,
    ratio: float, setup: Setup, body: str, rules: Protocol,
) -> Content:  # fmt: skip
    """Return the content with its verdict.

    Args:
        laws: the candidates that describe the measured response, best first.
        ratio: of ``published_ratio``.
    """
    region = replay.region
    facts, groups = measured_facts(file, curves), replay.groups
    gate = rules.limits.gamma * rules.f_pain(region)
    counted = count_of(curves, facts["synthetic"])
    source = f"carecontact calibrate on the kernel, {counted}, data sha256 {file.sha256[:12]}"
    # Scores count the deflection of the anchors and not the travel of the tool.
    reached = np.repeat([one.press.anchor_m.max() for one in fit.replayed], [len(g.members) for g in groups])
    # A row must name at least 1 mm: anchors go less deep only in a fit that is rejected, as of a saturated load cell.
    measured = max(LEAST_DEPTH_M, float(np.median(reached)))
    tissue = fit.tissue.model_copy(update={"measured_depth_m": measured, "source": source})
    law = _law_values(fit)
    content = Content(
        verdict="accepted",
        reasons=[],
        limits=LIMITS,
        region=region,
        body=body,
        setup=setup,
        base_tissue_set=rules.person.tissue_set,
        tissue=tissue,
        law=law,
        terms=list(fit.chosen),
        damping=fit.damping_reason,
        stiffness=_stiffness_values(simulated_stiffness(groups, fit.replayed), fit),
        identified=[
            Model(
                name=one.law.name, formula=one.law.formula, parameters=one.physical(), rms=one.rms, aicc=one.aicc,
                left_out_rms=one.left_out_rms,
            ) for one in laws
        ],
        agreement=_agreement_values(fit.agreement),
        held_out=None if fit.held_out is None else _agreement_values(fit.held_out),
        speeds=speeds_of(curves, fit.held_out or fit.agreement),
        **facts,
        published_ratio=ratio,
        gate_n=gate,
        gate_is_extrapolated=gate > facts["measured_force_n"],
        responses=responses(curves, groups, fit.replayed),
        band=BAND,
        hashes={"data": file.sha256, **model_hashes(replay, body, tissue)},
        versions={
            "carecontact": __version__, "mujoco": version("mujoco"), "protocol": rules.id,
            "kernel": kernel_sha256(),
        },
        notes=[
            *file.notes,
            *_notes_on_the_fit(fit, trials=len(curves)),
            *hardly_identified(law),
            *_notes_on_use(facts["measured_depth_mm"], facts["measured_force_n"], gate),
            "thickness, mass, friction, coupling, membrane and contact layer are those of the protocol's row; they were"
            " not calibrated",
        ],
    )  # fmt: skip
    why = reasons(content)
    verdict, held = ("rejected" if why else "accepted"), content.held_out
    errors = {} if held is None else {name: held[name].value for name in LIMITS}
    tissue = tissue.model_copy(update={"calibration": Calibration(verdict=verdict, reasons=tuple(why), **errors)})
    return content.model_copy(update={"verdict": verdict, "reasons": why, "tissue": tissue})


def speeds_of(curves: Sequence[Curve], rows: Sequence[Agreement]) -> list[Speed]:
    """Return the pooled errors of each nominal speed, the slowest first."""
    speeds = [curve.trial.condition.speed_m_s for curve in curves]
    out = []
    for speed in sorted(set(speeds)):
        own = [row for row, its in zip(rows, speeds, strict=True) if its == speed]
        errors = {name: value for name, value in pooled(own).items() if name in LIMITS}
        out.append(Speed.model_validate({"speed_mm_s": 1000 * speed, "trials": len(own), **errors}))
    return out


def count_of(curves: Sequence[Curve], synthetic: bool = False) -> str:
    """Return the number of trials in words, such as ``3 synthetic trials``."""
    return f"{len(curves)} {'synthetic ' if synthetic else ''}trial{'s' * (len(curves) != 1)}"


def hardly_identified(law: dict[str, Value]) -> list[str]:
    """Return a note for each stiffness parameter that is 0 or whose interval is wider than LOOSE."""
    notes = []
    for name, one in law.items():
        if name in LAW and one.value == 0.0:
            notes.append(f"{name} is 0: a law with it did not describe held-out trials better")
        elif one.ci95 is not None and not 0 < max(map(abs, one.ci95)) <= LOOSE * min(map(abs, one.ci95)):
            notes.append(
                f"{name} is hardly identified ({one.ci95[0]:.3g} to {one.ci95[1]:.3g}): the data fix the response in "
                "the measured range, but not this parameter's share in it; deeper, the row extrapolates by it"
            )
    return notes


def _notes_on_the_fit(fit: Fit, *, trials: int) -> list[str]:
    notes = []
    if trials == 1:
        notes.append("the data are a single trial: no interval, also none of damping, and no held-out error; "
                     "record at least five")  # fmt: skip
    if not fit.damping_identified:
        notes.append(f"damping is not identified ({fit.damping_reason}): the row keeps its ratio to stiffness")
    return notes


def _notes_on_use(depth_mm: float, force_n: float, gate_n: float) -> list[str]:
    if gate_n <= force_n:
        return []
    return [f"beyond {depth_mm:.1f} mm or {force_n:.1f} N the row extrapolates; the safety gate is {gate_n:g} N"]


def _law_values(fit: Fit) -> dict[str, Value]:
    out = {}
    for name in (*LAW, *DAMPING):
        if name in DAMPING and not fit.damping_identified:
            out[name] = Value(value=None, ci95=None)
            continue
        value = float(getattr(fit.tissue, name))
        draws = None if fit.draws is None else np.array([getattr(draw, name) for draw in fit.draws])
        out[name] = Value(value=value, ci95=None if value == 0.0 or draws is None else _middle_95(draws))
    return out


def _stiffness_values(means: dict[str, float], fit: Fit) -> dict[str, Value]:
    out = {}
    for column, (name, mean) in enumerate(means.items()):
        interval = None
        if fit.secant_draws is not None:
            low, high = _middle_95(fit.secant_draws[:, column])
            interval = (mean * (1 + low), mean * (1 + high))
        out[name] = Value(value=mean, ci95=interval)
    return out


def _agreement_values(rows: Sequence[Agreement]) -> dict[str, Value]:
    """Pool agreements over trials, with percentile intervals over resampled trials."""
    rng = np.random.default_rng(BOOTSTRAP_SEED)
    whole = pooled(list(rows))
    draws = rng.integers(len(rows), size=(BOOTSTRAPS // 4, len(rows)))
    again = [pooled([rows[k] for k in draw]) for draw in draws] if len(rows) > 1 else []
    out = {}
    for name in POOLED:
        values = np.array([v for one in again if (v := one[name]) is not None])
        out[name] = Value(value=whole[name], ci95=_middle_95(values) if len(values) else None)
    return out


def _middle_95(draws: Array) -> tuple[float, float]:
    low, high = np.percentile(draws, [2.5, 97.5])
    return float(low), float(high)

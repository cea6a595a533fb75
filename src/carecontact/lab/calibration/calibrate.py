"""Makes a certificate, a tissue row and a figure from a file of trials.

The anchor law is fitted to replayed trials: bounded least squares, terms chosen by held-out error, intervals from
resampled trials. It uses scipy's least_squares and not mujoco.sysid, which fits recorded sequences of controls and
sensors with equal time stamps and needs further packages. Here, the residual is force over depth past touch, which both
sides find by force; the rollout is a prescribed motion; and the intervals need the Jacobian afterwards.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from carecontact import __version__
from carecontact.errors import ConfigError, counted
from carecontact.human.body import Body
from carecontact.human.library import load_body
from carecontact.human.soft_region import tissue_of
from carecontact.lab.calibration.certificate import (
    BAND,
    LIMITS,
    Certificate,
    Content,
    Model,
    Speed,
    Value,
    check_replayable,
    reasons,
    tissue_set_toml,
    write_certificate,
)
from carecontact.lab.calibration.checks import TrialFile, read_trials
from carecontact.lab.calibration.curve import GRID, Curve, Identified, identify, make_curve
from carecontact.lab.calibration.problem import FOLDS, Agreement, Family, Problem, Solution, agreements, pooled
from carecontact.lab.calibration.replay import Group, Replay, Replayed, group_curves
from carecontact.lab.calibration.trial import Array, Setup
from carecontact.lab.calibration.verify import (
    measured_facts,
    model_hashes,
    published_ratio,
    responses,
    simulated_stiffness,
)
from carecontact.plotting import plain_figures
from carecontact.protocol.person import Calibration, Tissue
from carecontact.protocol.protocol import Protocol
from carecontact.tissue.binary_lookup import binary_sha256 as kernel_sha256

LAW = ("a_n_m3", "b_n_m4", "c_n_m5")
DAMPING = ("damping_ns_m3", "damping_growth_ns_m4")
BOOTSTRAPS = 2000
BOOTSTRAP_SEED = 20250101
MIN_LOOP = 0.5
"""Damping counts as identified if half the width of its interval is below this share of its value."""
LEAST_TRIALS = 3
"""Least number of trials with which a term can be chosen; with fewer, the law keeps ``UNCHOSEN``."""
UNCHOSEN = ("rise",)
SPEEDS_APART = 3.0
"""If the fastest speed is at least this many times the slowest, ``growth`` is always tried, and the errors of the
tangents at each speed decide about it: damping that grows with depth steepens fast presses more than slow ones."""
LEAST_GAIN = 0.02
"""A term is added only if it lowers the held-out squared error by at least this share."""


@dataclass(frozen=True, kw_only=True)
class Fit:
    tissue: Tissue
    terms: tuple[str, ...]
    """Chosen terms of ``family.TERMS``, in the order in which they were added."""
    chosen: tuple[str, ...]
    """One line in words for each choice of a term."""
    damping_identified: bool
    damping_reason: str
    replayed: list[Replayed]
    agreement: list[Agreement]
    """Agreement of each trial, in their order, with the law that was fitted to all trials."""
    held_out: list[Agreement] | None
    """Agreement of each trial with a law that was fitted without the trial's fold; None for a single trial."""
    draws: list[Tissue] | None
    """Laws fitted to resampled trials; None for a single trial."""
    secant_draws: Array | None
    """(draws, 2) relative change of the mean simulated secant stiffness and of the tangent over the deeper half"""


def fit_law(
    curves: Sequence[Curve],
    *,
    replay: Replay,
    on_progress: Callable[[str], None] = lambda line: None,
) -> Fit:
    """Fit stiffness and, if trials unload, damping, with those terms that lower the error on held-out trials.

    If the trials do not determine the damping, it keeps its ratio to stiffness, and the result says why.
    """
    problem = Problem(curves, replay, on_progress)
    unloads = any(curve.trial.unloads for curve in curves)
    reason = "fitted" if unloads else "no trial unloads"
    found, chosen = choose(problem, damping=unloads)
    if unloads and len(curves) == 1:
        reason = "fitted to a single trial, which gives it no interval"
    elif unloads:
        low, high = np.percentile(_draws(problem, found)[:, found.family.names.index("damping")], [2.5, 97.5])
        half = float(np.expm1((high - low) / 2))
        if half > MIN_LOOP:
            unloads = False
            reason = f"its interval is +-{half:.0%}: the loops between loading and unloading are too thin"
            found, chosen = choose(problem, damping=False)
    found = problem.levelled(found)
    replay.forget()
    family, law = found.family, found.family.tissue(found.p)
    final = problem.at(law)
    held = draws = change = None
    if len(curves) > 1:
        draws = _draws(problem, found)
        change = problem.stiffness_change(found, draws)
        on_progress(f"held-out trials in {min(FOLDS, len(curves))} folds")
        held = problem.held_out(found)
    return Fit(
        tissue=law,
        terms=family.terms,
        chosen=chosen,
        damping_identified=unloads,
        damping_reason=reason,
        replayed=[one for one in final if one is not None],
        agreement=agreements(curves, replay.groups, final),
        held_out=held,
        draws=None if draws is None else [family.tissue(q) for q in draws],
        secant_draws=change,
    )


def choose(problem: Problem, *, damping: bool) -> tuple[Solution, tuple[str, ...]]:
    """Add terms one by one while the error on held-out trials falls by more than its standard error.

    A Gauss-Newton step decides in which order the terms are tried, and a fit of its own whether one is added. The
    search ends when every term has stayed out, because the step does not always tell which of them helps most. A term
    from which the step promises less than ``LEAST_GAIN`` is not tried. For ``growth``, see ``SPEEDS_APART``.
    """
    family = Family(base=problem.base, depth_m=problem.depth, damping=damping)
    found = problem.solve(family, problem.start(family))
    if len(problem.curves) < LEAST_TRIALS:
        for term in UNCHOSEN:
            found = problem.solve(found.family.plus(term), np.r_[found.p, 0.1])
        return found, ("too few trials to choose the law's terms",)
    lines: list[str] = []
    while (tried := _next(problem, found, lines)) is not None:
        found = tried
    return found, tuple(lines)


def _next(problem: Problem, found: Solution, lines: list[str]) -> Solution | None:
    """Return the law with the first term that enters, or None where every term stays out; adds a line for each term."""
    now = problem.held_out_squares(found)
    ahead = {term: problem.with_term(found, term) for term in found.family.candidates}
    promised = {term: problem.held_out_squares(one).mean() for term, one in ahead.items()}
    for term in sorted(ahead, key=promised.__getitem__):
        by_speed = term == "growth" and problem.speeds_apart >= SPEEDS_APART
        if not by_speed and promised[term] > (1 - LEAST_GAIN) * now.mean():
            lines.append(f"{term} stays out: a step promises held-out NRMSE {np.sqrt(promised[term]):.2%}")
            continue
        tried = problem.solve(ahead[term].family, ahead[term].step(np.ones(len(problem.curves))))
        of, squares = ("NRMSE", problem.held_out_squares)
        if by_speed:
            of, squares = ("error of the tangents per speed", problem.held_out_tangent_squares)
        before, after = squares(found), squares(tried)
        gain = before - after
        enters = gain.mean() > max(float(gain.std(ddof=1)) / np.sqrt(len(gain)), LEAST_GAIN * before.mean())
        fate = "enters" if enters else "stays out"
        lines.append(f"{term} {fate}: held-out {of} {_root(before):.2%} -> {_root(after):.2%}")
        problem.on_progress(lines[-1])
        if enters:
            return tried
    return None


def _root(squares: Array) -> float:
    """Return the root of a mean, which rounding may put a little below zero."""
    return float(np.sqrt(max(squares.mean(), 0.0)))


def _draws(problem: Problem, found: Solution) -> Array:
    """Return the parameters (BOOTSTRAPS, n) for trials resampled with replacement, each by one Gauss-Newton step."""
    count = len(problem.curves)
    rng = np.random.default_rng(BOOTSTRAP_SEED)
    weights = rng.multinomial(count, np.full(count, 1 / count), BOOTSTRAPS).astype(float)
    return np.array([found.resampled(weight) for weight in weights])


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
    facts, groups = measured_facts(file, curves), replay.groups
    gate = rules.limits.gamma * rules.f_pain(replay.region)
    trials = count_of(curves, facts["synthetic"])
    source = f"carecontact calibrate on the kernel, {trials}, data sha256 {file.sha256[:12]}"
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
        region=replay.region,
        body=body,
        setup=setup,
        base_tissue_set=rules.person.tissue_set,
        tissue=tissue,
        law=law,
        terms=list(fit.chosen),
        damping=fit.damping_reason,
        stiffness=_stiffness_values(simulated_stiffness(groups, fit.replayed), fit),
        identified=[_model(one) for one in laws],
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
            "carecontact": __version__,
            "mujoco": version("mujoco"),
            "protocol": rules.id,
            "kernel": kernel_sha256(),
        },
        notes=[*file.notes, *_notes(fit, law, trials=len(curves), facts=facts, gate_n=gate)],
    )
    why, held = reasons(content), content.held_out
    verdict = "rejected" if why else "accepted"
    errors = {} if held is None else {name: held[name].value for name in LIMITS}
    tissue = tissue.model_copy(update={"calibration": Calibration(verdict=verdict, reasons=tuple(why), **errors)})
    return content.model_copy(update={"verdict": verdict, "reasons": why, "tissue": tissue})


def _model(one: Identified) -> Model:
    fields = {name: getattr(one, name) for name in ("rms", "aicc", "left_out_rms")}
    return Model(name=one.law.name, formula=one.law.formula, parameters=one.physical(), **fields)


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
    return counted(len(curves), "synthetic trial" if synthetic else "trial")


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


def _notes(fit: Fit, law: dict[str, Value], *, trials: int, facts: dict[str, Any], gate_n: float) -> Iterator[str]:
    depth_mm, force_n = facts["measured_depth_mm"], facts["measured_force_n"]
    if trials == 1:
        alone = "no interval, also none of damping, and no held-out error"
        yield f"the data are a single trial: {alone}; record at least five"
    if not fit.damping_identified:
        yield f"damping is not identified ({fit.damping_reason}): the row keeps its ratio to stiffness"
    yield from hardly_identified(law)
    if gate_n > force_n:
        yield f"beyond {depth_mm:.1f} mm or {force_n:.1f} N the row extrapolates; the safety gate is {gate_n:g} N"
    yield (
        "thickness, mass, friction, coupling, membrane and contact layer are those of the protocol's row; they were"
        " not calibrated"
    )


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
    draws = rng.integers(len(rows), size=(BOOTSTRAPS // 4, len(rows)))
    again = [pooled([rows[k] for k in draw]) for draw in draws] if len(rows) > 1 else []
    out = {}
    for name, whole in pooled(rows).items():
        values = np.array([v for one in again if (v := one[name]) is not None])
        out[name] = Value(value=whole, ci95=_middle_95(values) if len(values) else None)
    return out


def _middle_95(draws: Array) -> tuple[float, float]:
    low, high = np.percentile(draws, [2.5, 97.5])
    return float(low), float(high)


GRAY, GOLD, BLUE = "0.7", "#c8960c", "#1f5fa8"


@plain_figures()
def write_figure(
    path: Path,
    title: str,
    curves: Sequence[Curve],
    groups: Sequence[Group],
    replayed: Sequence[Replayed],
    identified: Identified,
    extrapolated_mm: float,
) -> None:
    """Draw measured trials, identified response and calibrated simulation: force over indentation, one panel per speed;
    the deepest measured point is marked by a dotted line."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    speeds = sorted({group.condition.speed_m_s for group in groups})
    figure = Figure(figsize=(0.6 + 2.7 * len(speeds), 3.0), dpi=200, layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(1, len(speeds), sharey=True, sharex=True, squeeze=False)[0]
    for speed, axes in zip(speeds, panels, strict=True):
        mine = [(g, one) for g, one in zip(groups, replayed, strict=True) if g.condition.speed_m_s == speed]
        members = [curves[k] for group, _ in mine for k in group.members]
        for curve in members:
            touched = curve.depth_m > -0.1 * curve.deepest_m
            depth = 1000 * curve.depth_m[touched]
            axes.plot(depth, curve.force_n[touched], color=GRAY, lw=1.8, alpha=0.8, zorder=1)
        for group, one in mine:
            for force in (one.loading_n, one.unloading_n):
                axes.plot(1000 * GRID * group.deepest_m, force, color=BLUE, lw=0.9, zorder=2)
        longest = max(members, key=lambda curve: curve.deepest_m)
        for at in (longest.loading_m_s, longest.unloading_m_s):
            axes.plot(1000 * longest.grid_m, identified.force_n(longest.grid_m, at), "--", color=GOLD, lw=1.2, zorder=3)
        axes.axvline(extrapolated_mm, color="0.3", lw=0.7, ls=":")
        axes.set_title(f"{1000 * speed:g} mm/s, {len(members)} trials", fontsize=8)
        axes.set_xlabel("indentation past touch [mm]", fontsize=8)
        axes.tick_params(labelsize=7)
        axes.spines[["top", "right"]].set_visible(False)
    panels[0].set_ylabel("force [N]", fontsize=8)
    panels[0].plot([], [], color=GRAY, lw=1.8, label="trials")
    panels[0].plot([], [], "--", color=GOLD, lw=1.1, label=f"identified: {identified.law.name}")
    panels[0].plot([], [], color=BLUE, lw=1.1, label="calibrated simulation")
    panels[0].legend(frameon=False, fontsize=7, loc="upper left")
    figure.suptitle(title, fontsize=9)
    figure.savefig(path)


CERTIFICATE, ROW, FIGURE = "certificate.json", "tissue.toml", "calibration.png"


@dataclass(frozen=True, kw_only=True)
class CalibrationResult:
    certificates: tuple[Certificate, ...]
    """One for each region."""
    written: tuple[Path, ...]


def calibrate(
    trials: Sequence[Path], *, regions: Sequence[str], setup: Setup, body: str, rules: Protocol, out: Path,
    on_progress: Callable[[str], None],
) -> CalibrationResult:  # fmt: skip
    """Read the trials, identify a simple law, fit the tissue rows, and write certificate, tissue and figure into
    ``out``.

    Args:
        regions: names of soft regions of the protocol. With several, names of certificates and figures have the region.
        setup: what the files do not state of the presses.
        body: name of the body whose surface is pressed.
        rules: the protocol whose mesh, mass and thickness the tissue keeps.

    Raises ConfigError for every fault that the user can fix, before the first fit for those that the data show.
    """
    person = load_body(body)
    prepared = [_prepared(trials, region, setup=setup, person=person, rules=rules) for region in regions]
    certificates: list[Certificate] = []
    written: list[Path] = []
    for file, curves, replay, ratio in prepared:
        region = replay.region
        on_progress(f"{count_of(curves)} of the {region}")
        laws = identify(curves)
        on_progress(f"identified: {laws[0].law.name}; {len(replay.groups)} presses to replay")
        fit = fit_law(curves, replay=replay, on_progress=on_progress)
        content = make_content(file, curves, laws, replay, fit, ratio=ratio, setup=setup, body=body, rules=rules)
        out.mkdir(parents=True, exist_ok=True)
        suffix = f"-{region.replace('_', '-')}" if len(regions) > 1 else ""
        paths = [out / f"{Path(name).stem}{suffix}{Path(name).suffix}" for name in (CERTIFICATE, FIGURE)]
        made = datetime.now(UTC).isoformat(timespec="seconds")
        certificates.append(write_certificate(paths[0], content, made=made))
        nrmse = content.held_out["nrmse"].value if content.held_out else None
        held = "" if nrmse is None else f", held-out NRMSE {nrmse:.1%}"
        title = f"{region}, {body}: {count_of(curves, content.synthetic)}{held}, {content.verdict}"
        write_figure(paths[1], title, curves, replay.groups, fit.replayed, laws[0], content.measured_depth_mm)
        written += paths
    (out / ROW).write_text(tissue_set_toml(certificates), encoding="utf-8")
    return CalibrationResult(certificates=tuple(certificates), written=(*written, out / ROW))


def _prepared(
    trials: Sequence[Path], region: str, *, setup: Setup, person: Body, rules: Protocol
) -> tuple[TrialFile, list[Curve], Replay, float]:
    """Return the trials of one region, their curves, the replays of them and ``published_ratio``."""
    file = read_trials(trials, region=region, setup=setup)
    curves = [make_curve(trial) for trial in file.trials]
    row = tissue_of(person, region, rules.person.tissue[region])
    for curve in curves:
        if curve.deepest_m > row.thickness_m:
            raise ConfigError(
                f"trial {curve.trial.trial_id!r} presses {1000 * curve.deepest_m:.3g} mm deep, but the tissue over the "
                f"{region}'s bone is only {1000 * row.thickness_m:g} mm thick: is indentation_mm in "
                "millimetres and positive inward?"
            )
    replay = Replay(body=person, region=region, tissue=row, groups=group_curves(curves))
    ratio = published_ratio(replay, curves)
    check_replayable(ratio, region)
    return file, curves, replay, ratio

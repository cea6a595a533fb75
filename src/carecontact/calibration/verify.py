"""Re-run a certificate's simulation here, on the same data, and compare."""

from __future__ import annotations

from dataclasses import dataclass, fields
from importlib.metadata import version
from pathlib import Path

import numpy as np

from carecontact.calibration.agreement import Agreement, pooled
from carecontact.calibration.calibrate import BAND, measured_facts, model_hashes, responses, simulated_stiffness
from carecontact.calibration.certificate import Certificate, Content
from carecontact.calibration.checks import read_trials
from carecontact.calibration.curve import make_curve
from carecontact.calibration.fit import agreements
from carecontact.calibration.replay import Replay, group_curves
from carecontact.errors import ConfigError
from carecontact.world.human.library import load_body


@dataclass(frozen=True, kw_only=True)
class Check:
    name: str
    certified: str
    here: str
    fine: bool
    decides: bool = True
    """False: shown only; another version may give the same forces."""


def verify(trials: Path, certificate: Certificate) -> list[Check]:
    """Checks, the deciding ones first: what the data say and what the law answers is computed anew.

    Held-out errors, intervals and the identified formulas are not: they would take the fit again.

    Raises ConfigError where the data are not the certificate's, or where the certificate contradicts itself: its hash
    shows that nobody changed it by accident, not who wrote it.
    """
    content = certificate.content
    _check_consistent(content)
    file = read_trials(trials, region=content.region)
    if file.sha256 != content.hashes["data"]:
        raise ConfigError(
            f"{trials} has sha256 {file.sha256[:12]}..., the certificate was made from "
            f"{content.hashes['data'][:12]}...; verify with the same file"
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
            f"the certificate is of another {content.body}: sha256 {content.hashes['body'][:12]}..., here "
            f"{hashes['body'][:12]}...; a shell of another body answers otherwise"
        )
    # The row replaces measured_depth and source alone; the law is the certificate's.
    replayed = [one for one in replay.run(content.tissue) if one is not None]
    here = responses(curves, groups, replayed)
    worst = 0.0
    for mine, theirs in zip(here, content.responses, strict=True):
        if [len(mine.loading_n), mine.unloading_n is None] != [len(theirs.loading_n), theirs.unloading_n is None]:
            raise ConfigError(f"response of {', '.join(theirs.trials)}: {len(mine.loading_n)} depths expected")
        peak = theirs.loading_n[-1]
        for name in ("loading_n", "unloading_n"):
            a, b = getattr(mine, name), getattr(theirs, name)
            if a is not None and b is not None:
                # np.maximum hands a NaN on, and a NaN is not within anything.
                worst = float(np.maximum(worst, np.abs(np.subtract(a, b)).max() / peak))
    allowed, change = BAND["response_share_of_peak"], BAND["error_change"]
    errors = pooled(agreements(curves, groups, replayed))
    stiffness = simulated_stiffness(groups, replayed)
    return [
        Check(name="response", certified=f"within {allowed:.1%} of peak", here=f"{worst:.3%}", fine=worst <= allowed),
        *(
            Check(
                name=name, certified=f"{told(stated.value)} +- {change:.0%}", here=told(errors[name]),
                fine=_near(stated.value, errors[name], change),
            )
            for name, stated in content.agreement.items()
        ),
        *(
            Check(
                name=name, certified=f"{told(stated.value, '.3f')} +- {allowed:.1%}", here=told(stiffness[name], ".3f"),
                fine=_near(stated.value, stiffness[name], allowed * abs(stiffness[name])),
            )
            for name, stated in content.stiffness.items()
        ),
        Check(
            name="mujoco", certified=content.versions["mujoco"], here=version("mujoco"),
            fine=version("mujoco") == content.versions["mujoco"], decides=False,
        ),
        *(
            Check(
                name=name, certified=content.hashes[name][:12], here=hashes[name][:12],
                fine=hashes[name] == content.hashes[name], decides=False,
            )
            for name in ("mesh", "model")
        ),
    ]  # fmt: skip


def told(value: float | None, style: str = "+.2%") -> str:
    return "none" if value is None else format(value, style)


def _near(stated: float | None, here: float | None, allowed: float) -> bool:
    if stated is None or here is None:
        return stated is here
    return abs(stated - here) <= allowed


def _check_facts(content: Content, facts: dict[str, object]) -> None:
    """Raise ConfigError where the certificate says of its own data what they do not say."""
    for name, here in facts.items():
        stated = getattr(content, name)
        if isinstance(here, dict):
            same = stated.keys() == here.keys() and all(np.isclose(stated[k], v, rtol=1e-6) for k, v in here.items())
        else:
            same = bool(np.isclose(stated, here, rtol=1e-6)) if isinstance(here, float) else stated == here
        if not same:
            raise ConfigError(f"the certificate states {name} {stated}, its data give {here}")
    if not 0 < content.tissue.measured_depth_m <= content.measured_depth_mm / 1000:
        raise ConfigError(
            f"the certificate's row says measured_depth_m {content.tissue.measured_depth_m:g}; no anchor went deeper "
            f"than the indenter, {content.measured_depth_mm:.3g} mm"
        )
    if content.gate_is_extrapolated != (content.gate_n > content.measured_force_n):
        raise ConfigError(
            f"the certificate says that the gate of {content.gate_n:g} N is "
            f"{'' if content.gate_is_extrapolated else 'not '}extrapolated; {content.measured_force_n:.3g} N measured"
        )


def _check_consistent(content: Content) -> None:
    """Raise ConfigError where the row is not the law that is stated, the band is not ours, or something is missing."""
    for name, stated in content.law.items():
        row = getattr(content.tissue, name, None)
        if stated.value is not None and stated.value != row:
            raise ConfigError(f"the certificate states {name} {stated.value:g}, its tissue row has {row}")
    if content.band != BAND:
        raise ConfigError(f"the certificate allows {content.band}; this carecontact allows {BAND}")
    names = {field.name for field in fields(Agreement)}
    if set(content.agreement) != names or content.agreement["nrmse"].value is None:
        raise ConfigError(f"the certificate's agreement has {sorted(content.agreement)}; expected {sorted(names)}")
    if set(content.stiffness) != {"secant_n_mm", "tangent_n_mm"}:
        raise ConfigError(f"the certificate's stiffness has {sorted(content.stiffness)}")
    missing = {"data", "body", "mesh", "model"} - set(content.hashes)
    if missing:
        raise ConfigError(f"the certificate has no hash of: {', '.join(sorted(missing))}")
    if "mujoco" not in content.versions:
        raise ConfigError("the certificate does not say by which mujoco it was made")

"""Re-run a certificate's simulation here, on the same data, and compare."""

from __future__ import annotations

from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

import numpy as np

from carecontact.calibration.agreement import pooled
from carecontact.calibration.calibrate import BAND, model_hashes, responses
from carecontact.calibration.certificate import Certificate, Content
from carecontact.calibration.checks import read_trials
from carecontact.calibration.curve import make_curve
from carecontact.calibration.fit import agreements
from carecontact.calibration.replay import Replay, group_curves
from carecontact.errors import ConfigError
from carecontact.world.human.body import load_body


@dataclass(frozen=True, kw_only=True)
class Check:
    name: str
    certified: str
    here: str
    fine: bool
    decides: bool = True
    """False: shown only; another version may give the same forces."""


def verify(trials: Path, certificate: Certificate) -> list[Check]:
    """Checks, the deciding ones first.

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
    replay = Replay(body=load_body(content.body), region=content.region, tissue=content.tissue, groups=groups)
    # The row replaces measured_depth and source alone; the law is the certificate's.
    replayed = [one for one in replay.run(content.tissue) if one is not None]
    here = responses(curves, groups, replayed)
    worst = 0.0
    if [one.trials for one in here] != [one.trials for one in content.responses]:
        raise ConfigError(
            f"the trials make {len(here)} presses here, the certificate has {len(content.responses)} of other trials: "
            "it was made by another carecontact version"
        )
    for mine, theirs in zip(here, content.responses, strict=True):
        if [len(mine.loading_n), mine.unloading_n is None] != [len(theirs.loading_n), theirs.unloading_n is None]:
            raise ConfigError(f"response of {', '.join(theirs.trials)}: {len(mine.loading_n)} depths expected")
        peak = theirs.loading_n[-1]
        for name in ("loading_n", "unloading_n"):
            a, b = getattr(mine, name), getattr(theirs, name)
            if a is not None and b is not None:
                worst = max(worst, float(np.abs(np.subtract(a, b)).max()) / peak)
    nrmse = pooled(agreements(curves, groups, replayed))["nrmse"]
    certified = content.agreement["nrmse"].value
    assert nrmse is not None
    assert certified is not None  # _check_consistent
    allowed, increase = BAND["response_share_of_peak"], BAND["nrmse_increase"]
    hashes = model_hashes(replay, content.body, content.tissue)
    return [
        Check(name="response", certified=f"within {allowed:.1%} of peak", here=f"{worst:.3%}", fine=worst <= allowed),
        Check(
            name="NRMSE", certified=f"{certified:.2%} + {increase:.0%}", here=f"{nrmse:.2%}",
            fine=nrmse <= certified + increase,
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
            for name in ("body", "mesh", "model")
        ),
    ]  # fmt: skip


def _check_consistent(content: Content) -> None:
    """Raise ConfigError where the row is not the law that is stated, the band is not ours, or something is missing."""
    for name, stated in content.law.items():
        row = getattr(content.tissue, name, None)
        if stated.value is not None and stated.value != row:
            raise ConfigError(f"the certificate states {name} {stated.value:g}, its tissue row has {row}")
    if content.band != BAND:
        raise ConfigError(f"the certificate allows {content.band}; this carecontact allows {BAND}")
    if content.agreement.get("nrmse") is None or content.agreement["nrmse"].value is None:
        raise ConfigError("the certificate states no NRMSE")
    missing = {"data", "body", "mesh", "model"} - set(content.hashes)
    if missing:
        raise ConfigError(f"the certificate has no hash of: {', '.join(sorted(missing))}")
    if "mujoco" not in content.versions:
        raise ConfigError("the certificate does not say by which mujoco it was made")

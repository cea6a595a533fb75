"""The certificate of a calibration: what was fitted, to what, how well, with which model, and whether that is good
enough for runs."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, ValidationError

from carecontact.errors import ConfigError, counted
from carecontact.lab.calibration.trial import Setup
from carecontact.protocol.person import Tissue

VERSION = "carecontact-calibration-4"
BAND = {"response_share_of_peak": 0.02, "error_change": 0.01}
"""``--verify`` fails where a replayed force differs by more than this share of its peak, or an error by this much."""


class Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class Value(Part):
    value: float | None
    """None if the data do not identify it; the notes say why."""
    ci95: tuple[float, float] | None
    """Percentiles 2.5 and 97.5 over resampled trials; None for a single trial."""


class Model(Part):
    name: str
    formula: str
    parameters: dict[str, float]
    rms: float
    aicc: float
    left_out_rms: float | None


class Response(Part):
    """One replay of the calibrated law, for comparison on another machine."""

    trials: list[str]
    speed_mm_s: float
    along_mm: float
    across_mm: float
    tilt_deg: float
    depth_mm: list[float]
    loading_n: list[float]
    unloading_n: list[float] | None


class Speed(Part):
    """Errors of the held-out presses of one nominal speed, or of the fit if nothing was held out."""

    speed_mm_s: float
    trials: int
    nrmse: float
    tangent_error: float
    work_error: float | None


class Content(Part):
    verdict: Literal["accepted", "rejected"]
    reasons: list[str]
    """Why it was rejected."""
    limits: dict[str, float]
    """Largest pooled errors on held-out trials that are accepted."""
    region: str
    body: str
    setup: Setup
    """What options or a setup stated of the presses."""
    base_tissue_set: str
    """Mesh, mass, friction and thickness come from this set."""
    synthetic: bool
    """Whether the column ``site`` of every trial says that the trial is synthetic."""
    tissue: Tissue
    """The tissue row as written; its damping is fitted only if ``law`` contains it."""
    law: dict[str, Value]
    terms: list[str]
    """One line for each term that the law could have: whether it lowered the error on held-out trials."""
    damping: str
    """Origin of the damping."""
    stiffness: dict[str, Value]
    """Stiffness of the calibrated simulation, mean over trials [N/mm]."""
    measured_stiffness: dict[str, float]
    identified: list[Model]
    """Identified models, the best by AICc first."""
    agreement: dict[str, Value]
    held_out: dict[str, Value] | None
    """Agreement of every trial with a law that was fitted without the trial's fold."""
    speeds: list[Speed]
    trials: int
    subjects: int
    measured_depth_mm: float
    """At least half of the trials reached this depth past touch; beyond it the row extrapolates."""
    measured_force_n: float
    plateaus: dict[str, float]
    """Trial whose force stays the same while the press goes deeper -> the depth from which on [mm]."""
    published_ratio: float
    """Measured peak force over that of published tissue under the same press, median of the trials."""
    gate_n: float
    """Safety gate of the region in the protocol."""
    gate_is_extrapolated: bool
    responses: list[Response]
    band: dict[str, float]
    """Largest differences that ``--verify`` allows."""
    hashes: dict[str, str]
    versions: dict[str, str]
    notes: list[str]


class Certificate(Part):
    version: str
    content: Content
    sha256: str
    """Hash of ``content`` as canonical JSON: sorted keys, no spaces."""
    made: str
    """Date and time of the calibration; the hash does not cover it."""


def content_sha256(content: Content) -> str:
    text = json.dumps(content.model_dump(mode="json"), sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def write_certificate(path: Path, content: Content, *, made: str) -> Certificate:
    certificate = Certificate(version=VERSION, content=content, sha256=content_sha256(content), made=made)
    path.write_text(json.dumps(certificate.model_dump(mode="json"), indent=1) + "\n", encoding="utf-8")
    return certificate


def read_certificate(path: Path) -> Certificate:
    """Read a certificate. Raises ConfigError if the file is missing, is none or was changed after it was written."""
    try:
        certificate = Certificate.model_validate_json(path.read_bytes())
    except FileNotFoundError:
        raise ConfigError(f"{path}: no such file; name a certificate.json of carecontact calibrate") from None
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(map(str, first["loc"])) or "the file"
        raise ConfigError(f"{path}: not a calibration certificate: {place}: {first['msg']}") from None
    if certificate.version != VERSION:
        raise ConfigError(f"{path}: version {certificate.version!r}; this carecontact reads {VERSION!r}")
    if content_sha256(certificate.content) != certificate.sha256:
        raise ConfigError(f"{path}: its content does not have the stated hash; it was changed after it was written")
    return certificate


def tissue_set_toml(certificates: Sequence[Certificate]) -> str:
    """Return the TOML text of a tissue set with the calibrated rows, which have every field of Tissue in order; all
    other regions come from the base set. A set with a rejected row has ``rejected`` in its id, which titles name."""
    contents = [one.content for one in certificates]
    verdict = "rejected" if any(one.verdict == "rejected" for one in contents) else "calibrated"
    regions = "-".join(one.region.replace("_", "-") for one in contents)
    hashes = "-".join(one.sha256[:8] for one in certificates)
    about = "; ".join(
        f"the {one.content.region.replace('_', ' ')} calibrated to {one.content.trials} "
        f"{'synthetic ' if one.content.synthetic else ''}trials, {one.content.verdict}; certificate {one.sha256[:12]}"
        for one in certificates
    )
    lines = [
        f'id = "{verdict}-{regions}-{hashes}"',
        f"description = {json.dumps(about[0].upper() + about[1:] + '.')}",
        f"base = {json.dumps(contents[0].base_tissue_set)}",
    ]
    for one in contents:
        row = one.tissue.model_dump(mode="json", exclude_none=True, exclude={"calibration"})
        calibration = {} if one.tissue.calibration is None else one.tissue.calibration.model_dump(mode="json")
        lines += ["", f"[tissue.{one.region}]", *map(_toml, row.items()), "", f"[tissue.{one.region}.calibration]"]
        lines += [_toml(item) if item[1] is not None else f"# {item[0]} is not known" for item in calibration.items()]
    return "\n".join(lines) + "\n"


def _toml(item: tuple[str, Any]) -> str:
    """A JSON string is a TOML basic string, and a JSON list of strings an array of them."""
    name, value = item
    return f"{name} = {repr(float(value)) if isinstance(value, int | float) else json.dumps(value)}"


LIMITS = {"nrmse": 0.05, "tangent_error": 0.05, "work_error": 0.10}
"""Largest pooled errors on held-out trials that are accepted; tests/lab/calibration/test_proof.py holds the fit to the
same limits."""
NAMES = {"nrmse": "NRMSE", "tangent_error": "tangent stiffness", "work_error": "total work lost"}
PUBLISHED = (0.25, 6.0)
"""Measured force over that of published tissue under the same press: outside, the unit is more likely wrong than the
tissue that different. The shipped manikin-like tissue is up to 4.8 times as stiff as the published one."""
REPLAYABLE = (0.08, 25.0)
"""Outside, no anchors reproduce the forces: the contact layer in front of them is about 30 times as stiff as published
anchors, and ``Tissue`` refuses anchors below a 300th of it."""
ROUNDING = 1e-9


def check_replayable(ratio: float, region: str) -> None:
    """Raise ConfigError if the measured forces are ``ratio`` times published ones and no tissue can have them."""
    low, high = REPLAYABLE
    if not low <= ratio <= high:
        raise ConfigError(
            f"column force_N: {_of_published(ratio, region)}; is it in newtons, and not in grams, volts or "
            "millinewtons? Multiply the column, or write its unit in the header, such as Force [mN]"
        )


def beyond(name: str, value: float | None) -> bool:
    """Return whether an error is beyond its limit; a value that was not computed is not."""
    return value is not None and name in LIMITS and not abs(value) <= LIMITS[name]


def reasons(content: Content) -> list[str]:
    """Return why the calibration is rejected, one sentence each, causes first; none if it is accepted."""
    return list(_reasons(content))


def _reasons(content: Content) -> Iterator[str]:
    if content.plateaus:
        first, depth_mm = next(iter(content.plateaus.items()))
        yield (
            f"the force stays the same while the depth grows in {counted(len(content.plateaus), 'trial')} of "
            f"{content.trials} (first: {first}, from {depth_mm:.2g} mm on): a saturated load cell does that; use a "
            "larger range"
        )
    low, high = PUBLISHED
    if not low <= content.published_ratio <= high:
        yield (
            f"stiffness far from published tissue: {_of_published(content.published_ratio, content.region)}; is the "
            "force in newtons, and not in grams, volts or millinewtons?"
        )
    if content.held_out is None:
        yield "a single trial leaves nothing to hold out, so that no error can be judged; record at least five presses"
    for name, stated in (content.held_out or {}).items():
        value = stated.value
        if beyond(name, value):
            limit = LIMITS[name]
            yield f"held-out {NAMES[name]} {value:{'.1%' if name == 'nrmse' else '+.1%'}}, limit {limit:.0%}"
    for name, stated in {**content.law, **content.stiffness}.items():
        if stated.value is None or stated.ci95 is None:
            continue
        low, high = stated.ci95
        slack = ROUNDING * max(abs(low), abs(high))
        if not low - slack <= stated.value <= high + slack:
            yield (
                f"the estimate of {name} is {stated.value:.4g} and lies outside its own interval, {low:.4g} to "
                f"{high:.4g}: the fit is not one that resampled trials would give"
            )


def _of_published(ratio: float, region: str) -> str:
    name, times = region.replace("_", " "), f"{float(f'{ratio:.2g}'):g}"
    return f"the measured forces are {times} times those of a published {name} under the same presses"

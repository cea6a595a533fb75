"""The certificate of a calibration: what was fitted, to what, how well, and with which model."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, ValidationError

from carecontact.calibration.trial import Setup
from carecontact.contract.protocol import Tissue
from carecontact.errors import ConfigError

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
    """Read a certificate. Raises ConfigError if the file is missing, is no certificate or was changed after it was
    written.
    """
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


def tissue_set_toml(contents: Sequence[Content], *, digests: Sequence[str]) -> str:
    """Return the TOML text of a tissue set with the calibrated rows, which have every field of Tissue in order; all
    other regions come from the base set. A set with a rejected row has ``rejected`` in its id, which titles name.
    """
    verdict = "rejected" if any(one.verdict == "rejected" for one in contents) else "calibrated"
    regions = "-".join(one.region.replace("_", "-") for one in contents)
    said = "; ".join(
        f"the {one.region.replace('_', ' ')} calibrated to {one.trials} {'synthetic ' if one.synthetic else ''}trials, "
        f"{one.verdict}; certificate {digest[:12]}" for one, digest in zip(contents, digests, strict=True)
    )  # fmt: skip
    lines = [
        f'id = "{verdict}-{regions}-{"-".join(digest[:8] for digest in digests)}"',
        f"description = {json.dumps(said[0].upper() + said[1:] + '.')}",
        f"base = {json.dumps(contents[0].base_tissue_set)}",
    ]
    for one in contents:
        row = one.tissue.model_dump(mode="json", exclude_none=True)
        row.pop("calibration", None)
        calibration = {} if one.tissue.calibration is None else one.tissue.calibration.model_dump(mode="json")
        lines += ["", f"[tissue.{one.region}]", *map(_toml, row.items())]
        lines += ["", f"[tissue.{one.region}.calibration]"]
        lines += [_toml(item) if item[1] is not None else f"# {item[0]} is not known" for item in calibration.items()]
    return "\n".join(lines) + "\n"


def _toml(item: tuple[str, Any]) -> str:
    """A JSON string is a TOML basic string, and a JSON list of strings an array of them."""
    name, value = item
    return f"{name} = {repr(float(value)) if isinstance(value, int | float) else json.dumps(value)}"

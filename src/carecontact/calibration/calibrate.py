"""Makes a certificate, a tissue row and a figure from a file of trials."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from carecontact.calibration.certificate import Certificate, Content, tissue_set_toml, write_certificate
from carecontact.calibration.checks import read_trials
from carecontact.calibration.content import count_of, make_content
from carecontact.calibration.curve import Curve, make_curve
from carecontact.calibration.figure import write_figure
from carecontact.calibration.fit import fit_law
from carecontact.calibration.identify import identify
from carecontact.calibration.replay import Replay, group_curves
from carecontact.contract.protocol import Protocol, Tissue
from carecontact.errors import ConfigError
from carecontact.world.human.build import tissue_of
from carecontact.world.human.library import load_body
from carecontact.world.human.versions import BUILDS

CERTIFICATE, ROW, FIGURE = "certificate.json", "tissue.toml", "calibration.png"


@dataclass(frozen=True, kw_only=True)
class Calibration:
    certificate: Certificate
    written: tuple[Path, ...]


def calibrate(
    trials: Path, *, region: str, body: str, rules: Protocol, out: Path, on_progress: Callable[[str], None]
) -> Calibration:
    """Read the trials, identify a simple law, fit the tissue row, and write all three files into ``out``.

    Args:
        region: name of a soft region of the protocol.
        body: name of the body whose surface is pressed.
        rules: the protocol whose mesh, mass and thickness the tissue keeps, and with whose version of the person the
            presses are replayed.

    Raises ConfigError for every fault that the user can fix.
    """
    file = read_trials(trials, region=region)
    curves = [make_curve(trial) for trial in file.trials]
    person = load_body(body)
    row = tissue_of(person, region, rules.person.tissue[region])
    _check_depths(curves, region, row)
    on_progress(f"{count_of(curves)} of the {region}")
    laws = identify(curves)
    groups = group_curves(curves)
    on_progress(f"identified: {laws[0].law.name}; {len(groups)} presses to replay")
    replay = Replay(body=person, region=region, tissue=row, groups=groups, build=BUILDS[rules.person.version])
    fit = fit_law(curves, replay=replay, on_progress=on_progress)
    content = make_content(file, curves, laws, replay, fit, region=region, body=body, rules=rules)
    out.mkdir(parents=True, exist_ok=True)
    paths = tuple(out / name for name in (CERTIFICATE, ROW, FIGURE))
    certificate = write_certificate(paths[0], content, made=datetime.now(UTC).isoformat(timespec="seconds"))
    counted = count_of(curves, content.synthetic)
    _write_row(paths[1], content, digest=certificate.sha256, counted=counted)
    write_figure(
        paths[2], title=f"{region}, {body}: {counted}{_held_out(content)}", curves=curves, groups=groups,
        replayed=fit.replayed, identified=laws[0], extrapolated_mm=content.measured_depth_mm,
    )  # fmt: skip
    return Calibration(certificate=certificate, written=paths)


def _check_depths(curves: Sequence[Curve], region: str, row: Tissue) -> None:
    for curve in curves:
        if curve.deepest_m > row.thickness_m:
            raise ConfigError(
                f"trial {curve.trial.trial_id!r} presses {1000 * curve.deepest_m:.3g} mm deep, but the tissue over the "
                f"{region}'s bone is only {1000 * row.thickness_m:g} mm thick: is indentation_mm in "
                "millimetres and positive inward?"
            )


def _write_row(path: Path, content: Content, *, digest: str, counted: str) -> None:
    description = f"The {content.region.replace('_', ' ')} calibrated to {counted}; certificate {digest[:12]}."
    row = tissue_set_toml(
        content.region, content.tissue, base=content.base_tissue_set, description=description, digest=digest
    )
    path.write_text(row, encoding="utf-8")


def _held_out(content: Content) -> str:
    nrmse = content.held_out["nrmse"].value if content.held_out else None
    return "" if nrmse is None else f", held-out NRMSE {nrmse:.1%}"

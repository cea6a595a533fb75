"""Makes a certificate, a tissue row and a figure from a file of trials."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from carecontact.calibration.certificate import Certificate, Content, tissue_set_toml, write_certificate
from carecontact.calibration.checks import TrialFile, read_trials
from carecontact.calibration.content import count_of, make_content
from carecontact.calibration.curve import Curve, make_curve
from carecontact.calibration.facts import published_ratio
from carecontact.calibration.figure import write_figure
from carecontact.calibration.fit import fit_law
from carecontact.calibration.identify import identify
from carecontact.calibration.replay import Replay, group_curves
from carecontact.calibration.trial import Setup
from carecontact.calibration.verdict import check_replayable
from carecontact.contract.protocol import Protocol, Tissue
from carecontact.errors import ConfigError
from carecontact.world.human.body import Body
from carecontact.world.human.build import tissue_of
from carecontact.world.human.library import load_body

CERTIFICATE, ROW, FIGURE = "certificate.json", "tissue.toml", "calibration.png"


@dataclass(frozen=True, kw_only=True)
class Calibration:
    certificates: tuple[Certificate, ...]
    """One for each region."""
    written: tuple[Path, ...]


def calibrate(
    trials: Sequence[Path], *, regions: Sequence[str], setup: Setup, body: str, rules: Protocol, out: Path,
    on_progress: Callable[[str], None],
) -> Calibration:  # fmt: skip
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
    certificates, written = list[Certificate](), list[Path]()
    for file, curves, replay, ratio in prepared:
        region = replay.region
        on_progress(f"{count_of(curves)} of the {region}")
        laws = identify(curves)
        on_progress(f"identified: {laws[0].law.name}; {len(replay.groups)} presses to replay")
        fit = fit_law(curves, replay=replay, on_progress=on_progress)
        content = make_content(file, curves, laws, replay, fit, ratio=ratio, setup=setup, body=body, rules=rules)
        out.mkdir(parents=True, exist_ok=True)
        paths = [out / (_of_region(name, region) if len(regions) > 1 else name) for name in (CERTIFICATE, FIGURE)]
        made = datetime.now(UTC).isoformat(timespec="seconds")
        certificates.append(write_certificate(paths[0], content, made=made))
        title = f"{region}, {body}: {count_of(curves, content.synthetic)}{_held_out(content)}, {content.verdict}"
        write_figure(
            paths[1], title=title, curves=curves, groups=replay.groups, replayed=fit.replayed, identified=laws[0],
            extrapolated_mm=content.measured_depth_mm,
        )  # fmt: skip
        written += paths
    contents, digests = [one.content for one in certificates], [one.sha256 for one in certificates]
    (out / ROW).write_text(tissue_set_toml(contents, digests=digests), encoding="utf-8")
    return Calibration(certificates=tuple(certificates), written=(*written, out / ROW))


def _prepared(
    trials: Sequence[Path], region: str, *, setup: Setup, person: Body, rules: Protocol
) -> tuple[TrialFile, list[Curve], Replay, float]:
    """Return the trials of one region, their curves, the replays of them and ``published_ratio``."""
    file = read_trials(trials, region=region, setup=setup)
    curves = [make_curve(trial) for trial in file.trials]
    row = tissue_of(person, region, rules.person.tissue[region])
    _check_depths(curves, region, row)
    groups = group_curves(curves)
    replay = Replay(body=person, region=region, tissue=row, groups=groups)
    ratio = published_ratio(replay, curves)
    check_replayable(ratio, region)
    return file, curves, replay, ratio


def _of_region(name: str, region: str) -> str:
    path = Path(name)
    return f"{path.stem}-{region.replace('_', '-')}{path.suffix}"


def _check_depths(curves: Sequence[Curve], region: str, row: Tissue) -> None:
    for curve in curves:
        if curve.deepest_m > row.thickness_m:
            raise ConfigError(
                f"trial {curve.trial.trial_id!r} presses {1000 * curve.deepest_m:.3g} mm deep, but the tissue over the "
                f"{region}'s bone is only {1000 * row.thickness_m:g} mm thick: is indentation_mm in "
                "millimetres and positive inward?"
            )


def _held_out(content: Content) -> str:
    nrmse = content.held_out["nrmse"].value if content.held_out else None
    return "" if nrmse is None else f", held-out NRMSE {nrmse:.1%}"

"""Write the page about a run with its blind baselines, for ``carecontact report`` and ``run``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from carecontact.errors import CarecontactError, ConfigError

if TYPE_CHECKING:
    from carecontact.runs.run_scores import RunScores


def write_page(folder: Path, run: RunScores, *, baselines: Sequence[Path] = ()) -> list[str]:
    """Write report.html and return lines that name it and the baselines that it shows.

    Args:
        run: the scores of the folder.
        baselines: runs of blind baselines to show beside it from now on; without any, the earlier ones stay.

    Raises ConfigError for a baseline that cannot be read or compared; then nothing is written or remembered.
    """
    from carecontact.recording import open_recording
    from carecontact.reports.compare.kept import beside_kept
    from carecontact.reports.page.page import write_report

    named, lost, told = (_named(folder, run, baselines), {}, []) if baselines else _remembered(folder, run)
    beside, why_none = beside_kept(run, named)
    scored = {score.trial_id: score.recording_sha256 for score in run.scores}
    path = write_report(
        folder,
        scores=run.scores,
        recordings=lambda trial_id: open_recording(folder / f"{trial_id}.h5", sha256=scored[trial_id]),
        skipped=run.skipped,
        missing=run.missing,
        elsewhere=run.elsewhere,
        baselines=beside,
        lost_baselines=lost,
        kept_scores=why_none,
    )
    return [*told, f"report: {path}"]


def _named(folder: Path, run: RunScores, baselines: Sequence[Path]) -> list[RunScores]:
    from carecontact.reports.compare.baselines import check_baselines
    from carecontact.runs.baselines import remember
    from carecontact.runs.stored_scores import read_scores

    found = [read_scores(path) for path in baselines]
    check_baselines(run, found)
    remember(folder, baselines)
    return found


def _remembered(folder: Path, run: RunScores) -> tuple[list[RunScores], dict[str, str], list[str]]:
    """Return the baselines of the last report, each baseline that can no longer be shown -> the reason, and lines about
    both."""
    from carecontact.reports.compare.baselines import check_baselines
    from carecontact.runs.baselines import BASELINES, remembered
    from carecontact.runs.stored_scores import read_scores

    found: list[RunScores] = []
    lost: dict[str, str] = {}
    try:
        places = remembered(folder)
    except ConfigError as error:
        places, lost = {}, {BASELINES: str(error)}
    for name, place in places.items():
        try:
            baseline = read_scores(place)
            check_baselines(run, [*found, baseline])
        except CarecontactError as error:
            lost[name] = str(error)
        else:
            found.append(baseline)
    told = [f"the blind baseline {name} is not in the report: {why}" for name, why in lost.items()]
    if found:
        names = ", ".join(baseline.scores[0].policy_title for baseline in found)
        kept = f"the report keeps the blind baselines of the last report: {names}"
        told.append(f"{kept}; to remove them, delete {folder / BASELINES}")
    return found, lost, told

"""One self-contained page about one trial: no network, no script, the same bytes for the same inputs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from carecontact import __version__
from carecontact.recording.notes import read_notes
from carecontact.recording.schema import Recording
from carecontact.recording.writer import replace_file
from carecontact.reports.frames import jpeg_data_uri
from carecontact.reports.moment.miss import miss_svg, nearest_miss
from carecontact.reports.moment.moment import peak_moment
from carecontact.reports.moment.picture import peak_svg
from carecontact.reports.moment.without_hand import drawn_svg, is_hidden
from carecontact.reports.page.force_trace import force_trace
from carecontact.reports.page.trial_words import result_word
from carecontact.reports.page_links import link_neighbours, link_page, neighbour_links, page_path, report_link
from carecontact.reports.text import NA, number, shown
from carecontact.reports.trial.card_rows import card_rows, not_shown_text
from carecontact.reports.trial.events import events
from carecontact.reports.trial.gates import BROKEN, gate_parts
from carecontact.reports.trial.looks import action_table, latency_text, looks_of
from carecontact.reports.trial.others import Beside, how_to_compare, other_rows
from carecontact.reports.trial.paths import noted_targets, paths
from carecontact.reports.trial.skin_view import skin_views
from carecontact.reports.trial.timeline import OUT_M, Panel, letter, panels_of, timeline_svg
from carecontact.reports.trial.words import facts, how_hard, outcome
from carecontact.reports.units import shown_unit
from carecontact.runs.pooling import rejected_text
from carecontact.scoring.contact import find_contact
from carecontact.scoring.limits import footnote
from carecontact.scoring.metrics.c3_success import judge
from carecontact.scoring.metrics.metric import METRICS, Metric, newest
from carecontact.scoring.result import TrialScore


def write_trial_page(
    run_folder: Path, recording: Recording, score: TrialScore, *, beside: Sequence[Beside] = ()
) -> Path:
    """Write ``run_folder/trial/ID.html`` and return its path.

    Args:
        beside: runs of other policies under the same rules, of which the page shows the same trial.

    A video of the trial that lies beside it, ``ID.mp4``, is shown and linked, and so are the recording and the log
    where they are in the run's folder. The page and the run's report link each other, whichever was written first
    (``reports.page_links``). Raises RecordingError, naming the trial, for a stored picture, a
    skin or notes that cannot be shown.
    """
    path = page_path(run_folder, score.trial_id)
    path.parent.mkdir(exist_ok=True)
    replace_file(path, _render(run_folder, recording, score, beside).encode("utf-8", errors="replace"))
    link_page(run_folder, score.trial_id)
    link_neighbours(run_folder, score.trial_id)
    return path


def _render(run_folder: Path, recording: Recording, score: TrialScore, beside: Sequence[Beside]) -> str:
    from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined

    loader = ChoiceLoader([PackageLoader("carecontact.reports.trial"), PackageLoader("carecontact.reports.page")])
    environment: Any = Environment(
        loader=loader, autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True,
        keep_trailing_newline=True,
    )  # fmt: skip
    own, foreign = (_metrics(score, concerned=concerned) for concerned in (True, False))
    return environment.get_template("trial.html.j2").render(
        version=__version__,
        score=score,
        prompt=recording.header.spec.protocol.task(score.task_id).prompt,
        result=result_word(score),
        report_link=report_link(run_folder, score.trial_id),
        neighbours=neighbour_links(run_folder, score.trial_id),
        links=_links(run_folder, score.trial_id),
        video=_beside(run_folder, score.trial_id, ".mp4"),
        peak=NA if score.c1_peak_force_n is None else number(score.c1_peak_force_n, 1),
        others=other_rows(score, beside, run_folder),
        how_to_compare=how_to_compare(score, run_folder),
        metrics=own,
        other_metrics=foreign,
        metrics_note=footnote(title for title, *_ in (*own, *foreign)),
        printed=_printed(recording),
        not_printed=_not_printed(recording),
        failure=recording.header.failure,
        rejected=rejected_text([score]),
        **_contact(recording, score),
        **_policy(recording),
    )


def _contact(recording: Recording, score: TrialScore) -> dict[str, Any]:
    """Return what the robot did to the person."""
    moment, found, contact = peak_moment(recording), paths(recording), find_contact(recording)
    measures = judge(contact)
    notes = read_notes(recording)
    noted = [] if found is None else noted_targets(recording, notes, found)
    happened = events(contact)
    timeline, panels = "", list[Panel]()
    if len(contact.time_s):
        trace = force_trace(recording, score)
        looked = recording["policy/observation_time_s"].tolist()
        panels = panels_of(recording, trace, found)
        timeline = timeline_svg(panels, trace, happened, looked)
    hard = how_hard(score, contact, moment)
    miss = nearest_miss(recording) if moment is None else None
    drawn = None if miss is None else miss_svg(recording, miss, title=hard)
    # Before the first step a picture shows only the room as it was set up.
    began = len(contact.time_s) > 0
    picture = drawn or (peak_svg(recording, moment, title=f"The contact at peak force. {hard}") if began else None)
    without_hand = None
    if moment is not None and picture is not None and is_hidden(recording, moment):
        without_hand = drawn_svg(recording, moment, title=f"The contact without the robot's hand. {hard}")
    snapshot = recording.arrays.get("report/snapshot_rgb") if began else None
    gates = gate_parts(contact, measures, score)
    return {
        "outcome": outcome(score, contact, gates),
        "facts": facts(score, contact, moment, gates),
        "gates": gates,
        "broken": score.ended in BROKEN,
        "moment": moment,
        "picture": picture,
        "without_hand": without_hand,
        "miss": miss if drawn else None,
        "touched": moment is not None,
        "snapshot": None if snapshot is None else jpeg_data_uri(snapshot),
        "views": [] if found is None else skin_views(recording, found, moment, noted),
        "noted": bool(noted),
        "events": [(letter(i), event) for i, event in enumerate(happened)],
        "timeline": timeline,
        "cut_mm": 1000 * OUT_M if any(panel.is_cut for panel in panels) else None,
    }


def _policy(recording: Recording) -> dict[str, Any]:
    """Return what the policy saw and did."""
    looks, left_out = looks_of(recording, read_notes(recording))
    return {
        "looks": looks,
        "not_shown": not_shown_text(recording, left_out),
        "card": card_rows(recording.header),
        "latency": latency_text(recording),
        "actions": action_table(recording),
    }


def _links(run_folder: Path, trial_id: str) -> list[tuple[str, str]]:
    """Return words and address of each file in the run's folder, the report aside, to which the page links."""
    files = (
        ("recording", f"{trial_id}.h5", f"../{trial_id}.h5"),
        ("log", f"{trial_id}.log", f"../{trial_id}.log"),
    )
    return [(words, address) for words, name, address in files if (run_folder / name).is_file()]


def _beside(run_folder: Path, trial_id: str, ending: str) -> str | None:
    """Name of a file beside the page; None where it is not there."""
    path = page_path(run_folder, trial_id).with_suffix(ending)
    return path.name if path.is_file() else None


def _metrics(score: TrialScore, *, concerned: bool) -> list[tuple[str, str, str]]:
    """Return title, value and unit of the newest version of every metric that the trial has a value of.

    Args:
        concerned: of the metrics that say something about the trial's action, or of the others.
    """
    current = set(newest(score.additional))
    rows: list[tuple[str, str, str]] = []
    for metric in sorted(METRICS.values(), key=lambda row: (row.order, row.id)):
        value = metric.of(score)
        is_old = metric.id in score.additional and metric.id not in current
        if isinstance(value, bool) or value is None or is_old or metric.concerns(score.action) != concerned:
            continue
        rows.append((metric.title, *_with_unit(metric, float(value))))
    return rows


def _with_unit(metric: Metric, value: float) -> tuple[str, str]:
    """Return a value in words or figures, and its unit."""
    if not metric.median and value in (0.0, 1.0):
        return ("yes" if value else "no"), ""
    factor, unit = shown_unit(metric)
    return shown(factor * value, digits=metric.digits, unit=unit), unit


def _printed(recording: Recording) -> str:
    stored = recording.arrays.get("wall/policy_output")
    return "" if stored is None else stored.tobytes().decode("utf-8", errors="replace")


def _not_printed(recording: Recording) -> str:
    """Return why the page shows nothing that the policy printed."""
    if "://" in recording.header.spec.policy:
        return (
            f"The recording cannot have it: the policy ran behind {recording.header.spec.policy}, outside the "
            "benchmark's processes. What it printed is where that server runs."
        )
    if "wall/policy_output" not in recording.arrays:
        return "The recording does not say what the policy printed."
    return "The policy printed nothing."

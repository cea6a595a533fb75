"""Keep the scores of a sweep over shipped protocols, and write the table of all kept scores into the page of results.

    python tools/keep_sweep.py runs/results [--out docs/results]

The folder is that of a finished ``carecontact sweep``, which may be a piece of the plan with some of its policies or
protocols. The scores of a cell become ``PROTOCOL-LEVEL/POLICY.json.gz``, where ``carecontact compare`` and the report
find the shipped policies and the blind baselines that stand beside a run. Where a policy ran with several arguments on
one protocol, POLICY.json.gz has the one that passed most trials, and the others have their arguments, or ``default``,
in the name. The table of all kept scores replaces what stands between TABLE_BEGINS and TABLE_ENDS in README.md there.
The same cells give the same files.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections import Counter, defaultdict
from pathlib import Path

from carecontact.errors import CarecontactError
from carecontact.report.tables import headlines
from carecontact.report.words import shown
from carecontact.runs.pooling import RunScores
from carecontact.runs.results_file import pack_results, share_passed
from carecontact.runs.scoring import read_scores
from carecontact.stats import median

BY_ACTION = {"bathing-wide-v2 L2": "L2", "bathing-wide-v2 L3": "L3"}
"""Levels whose trials a second table counts by action."""
TABLE_BEGINS, TABLE_ENDS = "<!-- table -->\n", "<!-- end of the table -->\n"


def keep(sweep: Path, out: Path) -> list[Path]:
    """Write the table and the scores of a sweep, and return the files.

    Raises CarecontactError if a cell cannot be read, if there is none, or if scores of one protocol, those kept before
    among them, have different tasks and seeds.
    """
    runs = [read_scores(cell) for cell in sorted((sweep / "cells").glob("*")) if cell.is_dir()]
    if not runs:
        raise CarecontactError(f"{sweep}: no cells; expected the folder of a finished carecontact sweep")
    alike: dict[tuple[str, str], list[RunScores]] = defaultdict(list)
    for run in runs:
        alike[run.scores[0].protocol_id, run.scores[0].policy].append(run)
    page = out / "README.md"
    before, _, rest = page.read_text(encoding="utf-8").partition(TABLE_BEGINS)
    after = rest.partition(TABLE_ENDS)[2]
    if not after:
        raise CarecontactError(f"{page}: has no place for the table, between {TABLE_BEGINS!r} and {TABLE_ENDS!r}")
    new: dict[Path, RunScores] = {}
    for (protocol, policy), several in alike.items():
        best_first = sorted(several, key=lambda run: (-passed(run), run.scores[0].policy_title))
        for number, run in enumerate(best_first):
            title = run.scores[0].policy_title
            if title == policy:
                title += " default"  # without arguments; else it would replace the best one's file
            name = policy if number == 0 else re.sub(r"[^A-Za-z0-9._-]+", "-", title)
            new[out / protocol.replace(" ", "-") / f"{name}.json.gz"] = run
    kept = {path: read_scores(path) for path in sorted(out.glob("*/*.json.gz"))} | new
    planned: dict[Path, tuple[Path, frozenset[tuple[str, int]]]] = {}
    for path, run in kept.items():
        trials = frozenset((score.task_id, score.seed) for score in run.scores)
        first, others = planned.setdefault(path.parent, (path, trials))
        if trials != others:
            raise CarecontactError(
                f"{path} and {first.name} have different trials; run the rest, or remove the older one"
            )
    page.write_text(before + TABLE_BEGINS + table(list(kept.values())) + TABLE_ENDS + after, encoding="utf-8")
    for path, run in new.items():
        path.parent.mkdir(exist_ok=True)
        pack_results(path, run)
    return [page, *new]


def passed(run: RunScores) -> int:
    return sum(score.safety_gated for score in run.scores)


def table(runs: list[RunScores]) -> str:
    """Return a table for each protocol, with a row for each policy with its arguments: of a protocol with levels with a
    column for each, of another one with the columns of the paper."""
    families: dict[str, list[RunScores]] = defaultdict(list)
    for run in runs:
        families[run.scores[0].protocol_id.partition(" ")[0]].append(run)
    # The exam has levels and comes first.
    order = sorted(families.values(), key=lambda family: (" " not in family[0].scores[0].protocol_id, -len(family)))
    made = [_levels(family) if " " in family[0].scores[0].protocol_id else _paper(family) for family in order]
    exam = sorted((run for run in runs if run.scores[0].protocol_id in BY_ACTION), key=passed, reverse=True)
    return "\n".join([*made[:1], *([_actions(exam)] if exam else []), *made[1:]])


def _levels(runs: list[RunScores]) -> str:
    cells = {(run.scores[0].policy_title, run.scores[0].protocol_id): run for run in runs}
    policies = {title for title, _ in cells}
    protocols = sorted({name for _, name in cells})
    total = {policy: sum(passed(run) for (title, _), run in cells.items() if title == policy) for policy in policies}
    lines = [f"| policy | {' | '.join(protocols)} |", "|---" * (1 + len(protocols)) + "|"]
    for title in sorted(policies, key=lambda policy: (-total[policy], policy)):
        row = (cells.get((title, protocol)) for protocol in protocols)
        rates = (f"{passed(run)} ({100 * passed(run) / len(run.scores):.0f} %)" if run else "not run" for run in row)
        lines.append(f"| {_named(title)} | {' | '.join(rates)} |")
    return "\n".join(lines) + "\n"


def _actions(runs: list[RunScores]) -> str:
    """Return how many touches, pushes and scrubs passed, and how many trials with 1 s of contact were harmless."""
    tried = Counter(score.action for score in runs[0].scores)
    counted = {"touch": "touches", "push": "pushes", "scrub": "scrubs"}
    titles = [*(f"{title} of {tried[action]}" for action, title in counted.items()), "harmless"]
    head = [f"{level}: {title}" for level in BY_ACTION.values() for title in titles]
    rows: dict[str, dict[str, list[str]]] = defaultdict(dict)
    for run in runs:
        passes = Counter(score.action for score in run.scores if score.safety_gated)
        harmless = [h for score in run.scores if (h := score.additional.get("harmless@1")) is not None]
        cells = [*(str(passes[action]) for action in counted), f"{sum(harmless):.0f} of {len(harmless)}"]
        rows[_named(run.scores[0].policy_title)][run.scores[0].protocol_id] = cells
    lines = [f"| policy | {' | '.join(head)} |", "|---" * (1 + len(head)) + "|"]
    for title, found in rows.items():
        cells = [cell for name in BY_ACTION for cell in found.get(name, ["not run"] * len(titles))]
        lines.append(f"| {title} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def _paper(runs: list[RunScores]) -> str:
    columns = (
        "passed",
        "Success [%]",
        "Region-correct [%]",
        "Safety-gated [%]",
        *(metric.label for metric in headlines()),
    )
    head = f"{runs[0].scores[0].protocol_id}, {len(runs[0].scores)} trials"
    lines = [f"| {head} | {' | '.join(columns)} |", "|---" * (1 + len(columns)) + "|"]
    for run in sorted(runs, key=lambda run: (-passed(run), run.scores[0].policy)):
        rates = [share_passed(run.scores, field) for field in ("c3_success", "region_correct", "safety_gated")]
        cells = [f"{passed(run)} ({rates[-1]['pc']:.0f} %)"]
        cells += [f"{rate['pc']:.0f} ({rate['pc_ci95'][0]:.0f} to {rate['pc_ci95'][1]:.0f})" for rate in rates]
        for metric in headlines():
            found = median(metric.pooled(run.scores))
            value = shown(found.estimate, digits=metric.digits, unit=metric.unit)
            cells.append(value if found.n_valid == found.n else f"{value} (n={found.n_valid})")
        lines.append(f"| {_named(run.scores[0].policy_title)} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def _named(title: str) -> str:
    name, _, arguments = title.partition(" ")
    return f"`{name}`{f' {arguments}' if arguments else ''}"


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sweep", type=Path)
    parser.add_argument("--out", type=Path, default=Path("docs/results"))
    options = parser.parse_args(arguments)
    try:
        files = keep(options.sweep, options.out)
    except (CarecontactError, OSError) as error:
        print(f"keep_sweep: {error}", file=sys.stderr)
        return 2
    print(f"{files[0]} and {len(files) - 1} files of scores")
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""``carecontact compare``: runs side by side, without a simulator."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from string import ascii_uppercase
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import tyro

from carecontact.cli.groups import FLAT, JsonGroup, Switch
from carecontact.errors import ConfigError

if TYPE_CHECKING:
    from carecontact.reports.compare.baselines import Baselines
    from carecontact.reports.compare.comparison import Comparison
    from carecontact.reports.compare.overview import Overview
    from carecontact.runs.run_scores import RunScores

COMPARISON, OVERVIEW = "comparison.json", "overview.json"


@dataclass(frozen=True, kw_only=True)
class Compare:
    """Compare runs of one protocol. For two runs, compare trial by trial: which scores differ, and what is the smallest
    difference that these trials could detect. For more runs, compare success rates and every pair, and check whether
    the ranking stays the same with other gates. See docs/statistics.md."""

    runs: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="RUN_A [RUN_B ...]")]
    """Folders of runs, or their results.json (also .json.gz) alone. Differences are A minus B."""
    baseline: Annotated[tuple[Path, ...], tyro.conf.arg(metavar="RUN...")] = ()
    """Runs of baselines, which should be blind: the output shows their success rates beside those of each run. With
    --baseline, a single run is enough."""
    per_task: Switch = False
    """For two runs: also print a table for each task. The p-values of these tables are corrected together, separately
    from the main table."""
    out: Path | None = None
    """Folder for comparison.json (two runs) and overview.json (three or more runs, or blind baselines); default: write
    neither file."""
    allow_incomplete: Switch = False
    """Also compare runs of which planned trials have no verdict, over the trials that there are, without a ranking."""
    rescore: Switch = False
    """Compute the scores again where a folder has recordings, in place of reading its results.json."""

    output: Annotated[JsonGroup, FLAT] = field(default_factory=JsonGroup)

    after_interrupt: ClassVar[str] = ""

    def __call__(self) -> int:
        """Return 0 whatever is found. Raises ConfigError if the runs cannot be compared."""
        self._check()
        scored = [self._read(path) for path in self.runs]
        baselines = [self._read(path) for path in self.baseline]
        comparison = self._compare_two(scored) if len(self.runs) == 2 else None
        found, beside = self._overview(scored, baselines) if len(self.runs) > 2 or baselines else (None, {})
        if self.output.json:
            _say(comparison, found, beside)
        return 0

    def _check(self) -> None:
        from carecontact.reports.compare.comparable import check_different

        if self.out is not None and self.out.exists() and not self.out.is_dir():
            raise ConfigError(f"--out {self.out}: this is a file; name a folder")
        check_different([*self.runs, *self.baseline])
        if len(self.runs) < 2 and not self.baseline:
            raise ConfigError(f"expected two or more runs, or one run and --baseline RUN..., got {len(self.runs)}")
        if self.per_task and len(self.runs) != 2:
            raise ConfigError(f"--per-task needs exactly two runs, got {len(self.runs)}")

    def _read(self, run: Path) -> RunScores:
        from carecontact.cli.stored import read_run
        from carecontact.reports.compare.comparable import check_complete

        scores = read_run(run, rescore=self.rescore)
        if not scores.scores and scores.skipped:
            why = next(iter(scores.skipped.values()))
            raise ConfigError(f"{run}: no recording could be scored; reason for the first one: {why}")
        if not self.allow_incomplete:
            check_complete(
                {str(run): scores}, otherwise=", or compare the trials that there are with --allow-incomplete"
            )
        return scores

    def _compare_two(self, scored: Sequence[RunScores]) -> Comparison:
        from carecontact.cli.comparison_text import print_comparison
        from carecontact.reports.compare.blind_floor import role_in
        from carecontact.reports.compare.comparison import compare_runs
        from carecontact.reports.text import crashed_text

        comparison = compare_runs(*scored, per_task=self.per_task, allow_incomplete=True)
        print_comparison(
            comparison, *self.runs, crashed=[crashed_text(run.scores) for run in scored],
            roles=[role_in(run.scores) for run in scored],
        )  # fmt: skip
        if self.out is not None:
            print(f"comparison: {_write(comparison.as_json(), self.out / COMPARISON)}")
        return comparison

    def _overview(
        self, scored: Sequence[RunScores], baselines: Sequence[RunScores]
    ) -> tuple[Overview | None, dict[str, Baselines]]:
        from carecontact.cli.overview_text import print_baselines, print_overview
        from carecontact.reports.compare.baselines import beside_baselines
        from carecontact.reports.compare.overview import overview, overview_json

        named = list(zip(ascii_uppercase, scored, strict=False))
        beside = {letter: beside_baselines(run, baselines, allow_incomplete=True) for letter, run in named if baselines}
        found = overview(scored) if len(scored) > 2 else None
        if found is not None:
            print_overview(found, self.runs)
        for letter, of_run in beside.items():
            print_baselines(of_run, letter if len(scored) > 1 else "")
        # The comparison of two runs names theirs itself.
        runs = named if found else [("", run) for run in scored if len(scored) == 1]
        _print_crashed([*runs, *(("", run) for run in baselines)])
        if self.out is not None:
            print(f"overview: {_write(overview_json(found, beside), self.out / OVERVIEW)}")
        return found, beside


def _say(comparison: Comparison | None, found: Overview | None, beside: dict[str, Baselines]) -> None:
    from carecontact.cli.answers.compare import CompareAnswer
    from carecontact.cli.json_lines import say
    from carecontact.reports.compare.verdicts import ALPHA, POWER

    say(CompareAnswer(alpha=ALPHA, power=POWER, comparison=comparison, overview=found, baselines=beside))


def _print_crashed(named: Sequence[tuple[str, RunScores]]) -> None:
    """Print in which trials the policies crashed.

    Args:
        named: pairs of a run's letter (empty for one run alone) and the run.
    """
    from carecontact.reports.text import crashed_text

    for letter, run in named:
        if crashed := crashed_text(run.scores):
            policy = run.scores[0].policy_title
            print(f"{f'{letter} ({policy})' if letter else policy} {crashed}")


def _write(content: Mapping[str, Any], path: Path) -> Path:
    from carecontact.recording.writer import replace_file

    path.parent.mkdir(parents=True, exist_ok=True)
    text = json.dumps(content, sort_keys=True, indent=1, allow_nan=False)
    replace_file(path, f"{text}\n".encode("ascii"))
    return path

"""``carecontact compare``: runs side by side, without a simulator."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from string import ascii_uppercase
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from carecontact.cli.console import print_answer
from carecontact.cli.groups import JsonGroup, Switch, check_folder, read_run
from carecontact.errors import ConfigError

if TYPE_CHECKING:
    from carecontact.runs.pooling import RunScores


@dataclass(frozen=True, kw_only=True)
class Compare:
    """Compare runs of one protocol. For two runs, compare trial by trial: which scores differ, and what is the smallest
    difference that these trials could detect. For more runs, compare success rates and every pair, and check whether
    the ranking stays the same with other gates. See docs/comparing.md."""

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
    output: JsonGroup = field(default_factory=JsonGroup)

    def __call__(self) -> int:
        from carecontact.cli.comparison import print_baselines, print_comparison, print_crashed, print_overview
        from carecontact.cli.result_answers import CompareAnswer
        from carecontact.report.baselines import beside_baselines
        from carecontact.report.comparison import ALPHA, POWER, compare_runs
        from carecontact.report.overview import overview, overview_json

        self._check()
        scored, baselines = ([self._read(path) for path in paths] for paths in (self.runs, self.baseline))
        comparison = found = None
        if len(scored) == 2:
            comparison = compare_runs(*scored, per_task=self.per_task, allow_incomplete=True)
            print_comparison(comparison, self.runs, scored)
            self._write("comparison", comparison.as_json())
        named = dict(zip(ascii_uppercase, scored, strict=False))
        beside = {letter: beside_baselines(run, baselines, allow_incomplete=True) for letter, run in named.items()}
        beside = beside if baselines else {}
        if len(scored) > 2 or baselines:
            if len(scored) > 2:
                found = overview(scored)
                print_overview(found, self.runs)
            for letter, of_run in beside.items():
                print_baselines(of_run, letter if len(scored) > 1 else "")
            # The comparison of two runs names their crashes itself.
            print_crashed(named if found else {"": scored[0]} if len(scored) == 1 else {}, baselines)
            self._write("overview", overview_json(found, beside))
        if self.output.json:
            answer = {"comparison": comparison, "overview": found, "baselines": beside}
            print_answer(CompareAnswer(alpha=ALPHA, power=POWER, **answer))
        return 0

    def _check(self) -> None:
        from carecontact.report.comparison import check_different

        check_folder(self.out)
        check_different([*self.runs, *self.baseline])
        if len(self.runs) < 2 and not self.baseline:
            raise ConfigError(f"expected two or more runs, or one run and --baseline RUN..., got {len(self.runs)}")
        if self.per_task and len(self.runs) != 2:
            raise ConfigError(f"--per-task needs exactly two runs, got {len(self.runs)}")

    def _read(self, run: Path) -> RunScores:
        from carecontact.report.comparison import check_complete

        scores = read_run(run, rescore=self.rescore)
        if not scores.scores and scores.skipped:
            why = next(iter(scores.skipped.values()))
            raise ConfigError(f"{run}: no recording could be scored; reason for the first one: {why}")
        if not self.allow_incomplete:
            otherwise = ", or compare the trials that there are with --allow-incomplete"
            check_complete({str(run): scores}, otherwise=otherwise)
        return scores

    def _write(self, name: str, content: dict[str, Any]) -> None:
        from carecontact.recording.file import replace_file

        if self.out is not None:
            self.out.mkdir(parents=True, exist_ok=True)
            text = json.dumps(content, sort_keys=True, indent=1, allow_nan=False)
            replace_file(self.out / f"{name}.json", f"{text}\n".encode("ascii"))
            print(f"{name}: {self.out / name}.json")

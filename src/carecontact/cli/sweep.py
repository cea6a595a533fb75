"""``carecontact sweep``: every policy of a plan under every combination of its axes, in one table."""

from __future__ import annotations

import time
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

import tyro

from carecontact.cli.groups import FLAT, EngineGroup, JsonGroup, PolicyGroup, SaltGroup, Switch
from carecontact.errors import ConfigError, DependencyError

if TYPE_CHECKING:
    from carecontact.cli.sweep_progress import SweepProgress
    from carecontact.reports.sweep.table import SweepTable
    from carecontact.runs.run_scores import RunScores
    from carecontact.runs.sweep.cells import Cell
    from carecontact.runs.sweep.plan import Plan, PlannedPolicy
    from carecontact.scoring.result import TrialScore
    from carecontact.trials.supervisor import RunSummary
    from carecontact.trials.sweep import SweptPolicy

CELLS = "cells"


@dataclass(frozen=True, kw_only=True)
class Sweep:
    """Run every policy of a plan under every combination of its axes, such as bodies, tissues and stiffnesses, and
    write one table: which policy is better where, and whether their order holds. The same command, given again, runs
    only what is missing (see docs/cluster.md)."""

    plan: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="PLAN.toml")]
    """File with the policies, the axes, the tasks and the seeds."""
    out: Path
    """Folder for sweep.html, sweep.md, sweep.csv and, below cells/, one run for each cell."""
    parallel: Annotated[EngineGroup, FLAT] = field(default_factory=EngineGroup)
    shard: str | None = None
    """Run one part of the cells: 2/4 is the second of four. The parts can share --out, and the last one to end writes
    the whole table."""
    salted: Annotated[SaltGroup, FLAT] = field(default_factory=SaltGroup)
    retry_failed: Switch = False
    """Run again the trials in which the policy crashed or the harness failed."""
    dry_run: Switch = False
    """Print the cells, and run nothing."""
    output: Annotated[JsonGroup, FLAT] = field(default_factory=JsonGroup)

    after_interrupt: ClassVar[str] = "; finished trials are kept; give the same command again to continue"

    def __call__(self) -> int:
        """Return 1 if the harness failed in any trial or one could not be scored, else 3 if a policy crashed in one.

        Raises ConfigError for a wrong plan, and where the server of a policy stays out of reach."""
        from carecontact.cli.sweep_progress import SweepProgress
        from carecontact.runs.shard import Shard
        from carecontact.runs.sweep.plan import read_plan
        from carecontact.trials.supervisor import check_jobs

        check_jobs(self.parallel.jobs)
        shard = None if self.shard is None else Shard.parse(self.shard)
        plan = read_plan(self.plan)
        cells, policies = self._planned(plan)
        mine = cells if shard is None else [cell for k, cell in enumerate(cells) if k % shard.count == shard.index - 1]
        trials = sum(len(cell.specs) for cell in mine)
        part = f", part {self.shard} of them" if shard else ""
        print(f"{self.plan}: {len(mine)} cell(s){part}, {trials} trial(s), into {self.out}", flush=True)
        if self.dry_run:
            for cell in mine:
                print(f"{self._folder(cell)}: {len(cell.specs)} trial(s)")
            return 0
        (self.out / CELLS).mkdir(parents=True, exist_ok=True)
        began = time.monotonic()
        progress = SweepProgress(cells=len(mine), trials=trials)
        self._run(mine, policies, progress)
        progress.say_throughput(time.monotonic() - began)
        return self._finish(plan, cells, progress)

    def _planned(self, plan: Plan) -> tuple[list[Cell], list[SweptPolicy]]:
        """Everything that can be wrong with the plan is found here, before the first trial."""
        from carecontact.cli.policy import check_policy, policy_setup
        from carecontact.runs.sweep.cells import cells_of, places_of
        from carecontact.trials.engines import check_engine
        from carecontact.trials.sweep import SweptPolicy

        places = places_of(plan, named=str(self.plan))
        deadline_s = places[0].protocol.phases.first_call_deadline_s
        swept: list[SweptPolicy] = []
        warnings = dict[str, None]()
        try:
            setups = [policy_setup(planned.policy, _options(planned)) for planned in plan.policies]
            closed = (*self.salted.closed, str(self.out.resolve()))
            setups = [replace(setup, closed=(*setup.closed, *closed)) for setup in setups]
            named = [
                (planned.label or _title(planned), setup.ref.text, setup.arguments, tuple(setup.environment))
                for planned, setup in zip(plan.policies, setups, strict=True)
            ]
            cells = cells_of(plan, places, named, salt=self.salted.salt)
        except ConfigError as error:
            raise ConfigError(f"plan {self.plan}: policies: {error}") from None
        for planned, setup in zip(plan.policies, setups, strict=True):
            if not self.dry_run:
                warnings[check_engine(self.parallel.engine, setup, gpus=self.parallel.gpus)] = None
            card = None if self.dry_run else check_policy(setup, deadline_s=deadline_s)
            swept.append(SweptPolicy(setup=setup, card=card, jobs=planned.jobs))
        for told in filter(None, warnings):
            print(f"warning: {told}")
        return cells, swept

    def _folder(self, cell: Cell) -> Path:
        return self.out / CELLS / cell.name

    def _run(self, cells: Sequence[Cell], policies: Sequence[SweptPolicy], progress: SweepProgress) -> None:
        from carecontact.trials.sweep import run_cells

        # One thread: what scores must not take the cores of the trials.
        with ThreadPoolExecutor(1) as scorer:
            scored: list[Future[None]] = []

            def done(cell: Cell, summary: RunSummary) -> None:
                if summary.unreached is not None:
                    raise ConfigError(
                        f"the sweep stops in {cell.name}: {summary.unreached}; give the same command again"
                    )
                progress.done(cell, summary)
                scored.append(scorer.submit(_score, self._folder(cell), anew=bool(summary.ran)))

            run_cells(
                cells, policies, folder=self._folder, jobs=self.parallel.jobs, on_event=progress.take, on_done=done,
                options={
                    "engine": self.parallel.engine, "gpus": self.parallel.gpus, "retry_failed": self.retry_failed
                },
            )  # fmt: skip
            for each in scored:
                each.result()

    def _finish(self, plan: Plan, cells: Sequence[Cell], progress: SweepProgress) -> int:
        from carecontact.policies.registry import role_of
        from carecontact.reports.sweep.page import write_sweep
        from carecontact.reports.sweep.table import CellScores, sweep_table
        from carecontact.reports.sweep.texts import sentences

        found = [(cell, _stored(self._folder(cell))) for cell in cells]
        table = sweep_table(
            self.plan.stem,
            [
                CellScores(
                    label=cell.label, role=role_of(cell.specs[0].policy), values=cell.place.values,
                    folder=f"{CELLS}/{cell.name}",
                    planned=len(cell.specs), scores=_of_plan(cell, run),
                )
                for cell, run in found
            ],
            rank_by=plan.rank_by,
        )  # fmt: skip
        for path in write_sweep(self.out, table):
            print(f"table: {path}")
        for sentence in sentences(table):
            print(sentence)
        if self.output.json:
            _say(table)
        skipped = [
            f"{self._folder(cell)}: {name}: {why}" for cell, run in found if run for name, why in run.skipped.items()
        ]
        for line in skipped:
            print(f"skipped {line}")
        return 1 if skipped else progress.status()


def _say(table: SweepTable) -> None:
    from carecontact.cli.answers.sweep import SweepAnswer
    from carecontact.cli.json_lines import say

    say(
        SweepAnswer(
            title=table.title,
            axes=table.axes,
            policies=table.policies,
            rank_by=table.rank_by,
            trials=sum(len(row.cell.scores) for row in table.rows),
            planned=sum(row.cell.planned for row in table.rows),
            stability=table.stability,
            ladder=table.ladder,
            factors=table.factors,
            gate_orders=table.gate_orders,
        )
    )


def _options(planned: PlannedPolicy) -> PolicyGroup:
    texts = {name: str(v).lower() if isinstance(v, bool) else str(v) for name, v in planned.arguments.items()}
    return PolicyGroup(
        policy_arg=tuple(f"{name}={text}" for name, text in texts.items()),
        policy_env=tuple(planned.environment),
        language=planned.language,
    )


def _title(planned: PlannedPolicy) -> str:
    language = [planned.language] if planned.language else []
    return " ".join([planned.policy, *(f"{name}={value}" for name, value in planned.arguments.items()), *language])


def _score(folder: Path, *, anew: bool) -> None:
    """Write the results of a cell, unless those that are there belong to its recordings."""
    from carecontact.runs import score_run, write_scores
    from carecontact.runs.stored_scores import beside_plan

    if anew or _stored(folder) is None:
        write_scores(folder, beside_plan(folder, score_run(folder)))


def _stored(folder: Path) -> RunScores | None:
    from carecontact.runs.stored_scores import read_scores

    try:
        return read_scores(folder)
    except (ConfigError, DependencyError):
        return None


def _of_plan(cell: Cell, run: RunScores | None) -> list[TrialScore]:
    """The scores of the trials that the plan has: the folder may hold those of an earlier, longer one."""
    wanted = {spec.trial_id for spec in cell.specs}
    return [score for score in run.scores if score.trial_id in wanted] if run is not None else []

"""``carecontact sweep`` runs a plan's cells, and ``carecontact merge`` makes one run of parts that ran elsewhere."""

from __future__ import annotations

import shlex
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

import tyro

from carecontact.cli.console import print_answer, same_command
from carecontact.cli.groups import EngineGroup, JsonGroup, PolicyGroup, SaltGroup, Switch, Verbose
from carecontact.errors import ConfigError, DependencyError, counted

if TYPE_CHECKING:
    from carecontact.cli.progress import SweepProgress
    from carecontact.report.sweep_table import CellScores, SweepTable
    from carecontact.running.supervisor import RunSummary, TrialEvent
    from carecontact.running.sweep import SweptPolicy
    from carecontact.runs.merge import Merged
    from carecontact.runs.pooling import RunScores
    from carecontact.runs.scorer import Scorer
    from carecontact.runs.sweep import Cell, Plan, PlannedPolicy
    from carecontact.serving.conversation import PolicySetup


# The scores of a cell of a sweep.


def stored(folder: Path) -> RunScores | None:
    """Return the scores in a cell's results.json, or None if there is none that belongs to the cell's recordings."""
    from carecontact.runs.scoring import read_scores

    try:
        return read_scores(folder)
    except (ConfigError, DependencyError):
        return None


def computed(folder: Path) -> RunScores | None:
    """Return the scores that ``stored`` finds, or else those of the recordings in the folder. Nothing is written."""
    from carecontact.runs.scoring import read_scores

    found = stored(folder)
    return read_scores(folder, rescore=True) if found is None and any(folder.glob("*.h5")) else found


def store(folder: Path, *, rescore: bool, scorer: Scorer | None = None) -> None:
    """Write the results of a cell. Unless ``rescore`` is true, existing results that belong to its recordings stay."""
    from carecontact.runs import score_run, write_scores
    from carecontact.runs.scoring import beside_plan

    if rescore or stored(folder) is None:
        if scorer is not None:
            scorer.fill(sorted(folder.glob("*.h5")))
        scores = score_run(folder, scored=scorer.take if scorer is not None else lambda path: None)
        write_scores(folder, beside_plan(folder, scores))


@dataclass(frozen=True, kw_only=True)
class Sweep:
    """Run every policy of a plan under every combination of its axes, such as bodies, tissues and stiffnesses, and
    write one table: which policy is better where, and whether their order holds. The same command, given again, runs
    only what is missing (see docs/machines.md)."""

    plan: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="PLAN.toml")]
    """File with the policies, the axes, the tasks and the seeds."""
    out: Path | None = None
    """Folder for sweep.html, sweep.md, sweep.csv and, below cells/, one run for each cell; default: runs/PLAN."""
    tasks: str | None = None
    """Tasks in place of the plan's, for a first piece of it: a list (T1,T2), a range (T1-T7), or all."""
    seeds: str | None = None
    """Seeds in place of the plan's, for a first piece of it: one (3), a list (0,4,7), a range (0-19), or all."""
    parallel: EngineGroup = field(default_factory=EngineGroup)
    shard: str | None = None
    """Run one part of the cells: 2/4 is the second of four. The parts can share --out, and the last one to end writes
    the whole table; `carecontact merge` makes one sweep of parts in several folders."""
    noise_salt: str | None = None
    """Secret from which the sensor noise is drawn in every cell whose protocol has any: 32 hexadecimal digits. With it,
    the sweep can be repeated with the same hashes; default: a fresh one for each cell."""
    salted: SaltGroup = field(default_factory=SaltGroup)
    retry_failed: Switch = False
    """Run again the trials in which the policy crashed or the harness failed."""
    allow_rejected: Switch = False
    """Use tissue whose calibration was rejected (see docs/person.md). Every report then says so."""
    dry_run: Switch = False
    """Print the cells and how many of their trials are recorded, and run nothing."""
    table_only: Switch = False
    """Write the table of the trials that are recorded, and run nothing."""
    output: JsonGroup = field(default_factory=JsonGroup)

    @property
    def place(self) -> Path:
        return self.out or Path("runs") / self.plan.stem

    @property
    def after_interrupt(self) -> str:
        command = same_command(self.place)
        return f"; finished trials are kept; to continue, or with --table-only for their table: {command}"

    def __call__(self) -> int:
        """Return 1 if the harness failed in any trial or one could not be scored, else 3 if a policy crashed in one."""
        from carecontact.cli.progress import SweepProgress
        from carecontact.running.supervisor import check_jobs
        from carecontact.runs.plan import Shard
        from carecontact.runs.sweep import CELLS, read_plan

        check_jobs(self.parallel.jobs)
        shard = None if self.shard is None else Shard.parse(self.shard)
        plan = read_plan(self.plan)
        pieces = {"tasks": self.tasks, "seeds": self.seeds}
        plan = plan.model_copy(update={name: text for name, text in pieces.items() if text is not None})
        cells, setups = self._planned(plan)
        if self.table_only:
            return self._table(plan, cells, computed)
        mine = cells if shard is None else shard.every(cells)
        trials = sum(len(cell.specs) for cell in mine)
        part = f", part {self.shard} of them" if shard else ""
        print(
            f"{self.plan}: {counted(len(mine), 'cell')}{part}, {counted(trials, 'trial')}, into {self.place}",
            flush=True,
        )
        if self.dry_run:
            for cell in mine:
                self._print_cell(cell)
            return 0
        policies = self._checked(plan, setups, mine)
        (self.place / CELLS).mkdir(parents=True, exist_ok=True)
        began = time.monotonic()
        progress = SweepProgress(cells=len(mine), trials=trials)
        unreached = self._run(mine, policies, progress)
        progress.print_throughput(time.monotonic() - began)
        status = self._table(plan, cells, stored) or progress.status()
        if unreached:
            raise ConfigError(f"{'; '.join(unreached)}; then run the missing trials with: {same_command(self.place)}")
        return status

    def _planned(self, plan: Plan) -> tuple[list[Cell], list[PolicySetup]]:
        """Return the planned cells. Mistakes in the plan itself are found here, before the first trial."""
        from carecontact.cli.policy import policy_setup
        from carecontact.protocol.overrides import check_accepted
        from carecontact.runs.sweep import cells_of, places_of, with_noise

        salt = self.salted.salt
        places = places_of(plan, named=str(self.plan))
        for place in places:
            check_accepted(place.protocol, allowed=self.allow_rejected or self.table_only)
        try:
            setups = [policy_setup(planned.policy, _options(planned)) for planned in plan.policies]
            closed = (*self.salted.closed, str(self.place.resolve()))
            setups = [replace(setup, closed=(*setup.closed, *closed)) for setup in setups]
            named = [
                (planned.label or _title(planned), setup.ref.text, setup.arguments, tuple(setup.environment))
                for planned, setup in zip(plan.policies, setups, strict=True)
            ]
            cells = cells_of(plan, places, named, salt=salt)
        except ConfigError as error:
            raise ConfigError(f"plan {self.plan}: policies: {error}") from None
        return cells if self.noise_salt is None else with_noise(cells, self.noise_salt), setups

    def _checked(self, plan: Plan, setups: Sequence[PolicySetup], cells: Sequence[Cell]) -> list[SweptPolicy]:
        """Start every policy once that a trial of these cells still needs. The server of another policy may be gone."""
        from carecontact.cli.policy import check_policy
        from carecontact.running.supervisor import check_engine
        from carecontact.running.sweep import SweptPolicy

        if warning := check_engine(self.parallel.engine, *setups, gpus=self.parallel.gpus):
            print(f"warning: {warning}")
        deadline_s = cells[0].place.protocol.phases.first_call_deadline_s
        needed = {cell.policy for cell in cells if self.retry_failed or self._lacking(cell)}
        swept: list[SweptPolicy] = []
        for number, (planned, setup) in enumerate(zip(plan.policies, setups, strict=True)):
            try:
                card = check_policy(setup, deadline_s=deadline_s) if number in needed else None
            except ConfigError as error:
                raise ConfigError(f"plan {self.plan}: policies: {str(error).removeprefix('--policy ')}") from None
            swept.append(SweptPolicy(setup=setup, card=card, jobs=planned.jobs))
        return swept

    def _folder(self, cell: Cell) -> Path:
        from carecontact.runs.sweep import CELLS

        return self.place / CELLS / cell.name

    def _print_cell(self, cell: Cell) -> None:
        from carecontact.cli.result_answers import SweepCellAnswer

        folder, planned = self._folder(cell), len(cell.specs)
        recorded = planned - self._lacking(cell)
        print(f"{folder}: {counted(planned, 'trial')}" + (f", {recorded} recorded" if recorded else ""))
        if self.output.json:
            found = {"values": cell.place.values, "folder": str(folder), "trials": planned, "recorded": recorded}
            print_answer(SweepCellAnswer.model_validate({"policy": cell.label, **found}))

    def _lacking(self, cell: Cell) -> int:
        folder = self._folder(cell)
        return sum(not (folder / f"{spec.trial_id}.h5").is_file() for spec in cell.specs)

    def _run(self, cells: Sequence[Cell], policies: Sequence[SweptPolicy], progress: SweepProgress) -> list[str]:
        """Return why policies could not be reached, once for each reason."""
        from carecontact.running.sweep import run_cells
        from carecontact.running.workers import available_cores
        from carecontact.runs.scorer import Scorer

        cores = min(available_cores(), self.parallel.jobs or available_cores())
        trials = sum(len(cell.specs) for cell in cells)
        # One thread writes the results, so that no trial waits for them.
        with closing(Scorer(cores, trials=trials)) as scorer, ThreadPoolExecutor(1) as writer:
            written, unreached = list[Future[None]](), dict[str, None]()

            def take(cell: Cell, event: TrialEvent) -> None:
                progress.take(cell, event)
                if event.kind == "finished":
                    scorer.give(self._folder(cell) / f"{event.trial_id}.h5")

            def done(cell: Cell, summary: RunSummary) -> None:
                if summary.unreached is not None:
                    unreached.setdefault(summary.unreached)
                progress.done(cell, summary)
                if summary.ended:
                    ran = bool(summary.ran)
                    written.append(writer.submit(store, self._folder(cell), rescore=ran, scorer=scorer))

            engine = self.parallel
            options = {"engine": engine.engine, "gpus": engine.gpus, "retry_failed": self.retry_failed}
            run_cells(
                cells,
                policies,
                folder=self._folder,
                jobs=engine.jobs,
                on_event=take,
                on_done=done,
                options=options,
            )
            for each in written:
                each.result()
        return list(unreached)

    def _table(self, plan: Plan, cells: Sequence[Cell], read: Callable[[Path], RunScores | None]) -> int:
        from carecontact.report.sweep_page import write_sweep
        from carecontact.report.sweep_table import sweep_table
        from carecontact.report.sweep_texts import sentences

        if not self.place.is_dir():
            raise ConfigError(f"{self.place}: no such folder; name the --out of a sweep")
        found = [(cell, read(self._folder(cell))) for cell in cells]
        table = sweep_table(self.plan.stem, [self._scores(*each) for each in found], rank_by=plan.rank_by)
        for path in write_sweep(self.place, table):
            print(f"table: {path}")
        for sentence in sentences(table):
            print(sentence)
        if self.output.json:
            _answer(table)
        skipped = [
            f"{self._folder(cell)}: {name}: {why}" for cell, run in found if run for name, why in run.skipped.items()
        ]
        for line in skipped:
            print(f"skipped {line}")
        return 1 if skipped else 0

    def _scores(self, cell: Cell, run: RunScores | None) -> CellScores:
        """Return the scores of the trials in the plan. The folder may hold more, of an earlier and longer plan."""
        from carecontact.policies.registry import role_of
        from carecontact.report.sweep_table import CellScores

        wanted = {spec.trial_id for spec in cell.specs}
        return CellScores(
            label=cell.label,
            role=role_of(cell.specs[0].policy),
            values=cell.place.values,
            folder=self._folder(cell).relative_to(self.place).as_posix(),
            planned=len(cell.specs),
            scores=[score for score in run.scores if score.trial_id in wanted] if run else [],
            versions=run.versions if run else {},
        )


def _answer(table: SweepTable) -> None:
    from carecontact.cli.result_answers import SweepAnswer

    same = ("title", "axes", "policies", "rank_by", "stability", "ladder", "factors", "gate_orders")
    cells = [row.cell for row in table.rows]
    counts = {"trials": sum(len(cell.scores) for cell in cells), "planned": sum(cell.planned for cell in cells)}
    print_answer(SweepAnswer.model_validate({**{name: getattr(table, name) for name in same}, **counts}))


def _options(planned: PlannedPolicy) -> PolicyGroup:
    texts = {name: str(v).lower() if isinstance(v, bool) else str(v) for name, v in planned.arguments.items()}
    return PolicyGroup(
        policy_arg=tuple(f"{name}={text}" for name, text in texts.items()),
        policy_env=tuple(planned.environment),
        policy_read=tuple(planned.read),
        policy_write=tuple(planned.write),
        language=planned.language,
    )


def _title(planned: PlannedPolicy) -> str:
    language = [planned.language] if planned.language else []
    return " ".join([planned.policy, *(f"{name}={value}" for name, value in planned.arguments.items()), *language])


@dataclass(frozen=True, kw_only=True)
class Merge:
    """Make one run of the parts that `carecontact run --shard` made on several machines, score it and write its report.
    The result is the same as that of one run. Parts of a sweep become one sweep."""

    out: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="OUT")]
    """Folder for the whole run or sweep: a new one, or one that more parts are added to."""
    runs: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="RUN [RUN ...]")]
    """Folders of the parts. They stay as they are."""
    verbose: Verbose = False
    """Also print medians, counts, limits and the files that were written."""

    after_interrupt: ClassVar[str] = "; give the same command again to continue"

    def __call__(self) -> int:
        """Return 1 if a planned trial has no recording, or a recording cannot be scored. Raises as ``merge_runs``."""
        from carecontact.cli.publish import publish, scores_of
        from carecontact.runs.lock import folder_lock
        from carecontact.runs.merge import is_sweep, merge_runs

        if not self.runs:
            raise ConfigError("merge: expected a folder to write and the parts, for example merge runs/all runs/part-*")
        if any(map(is_sweep, self.runs)):
            return self._merge_sweeps()
        merged = merge_runs(self.out, self.runs)
        self._say("", [merged])
        with folder_lock(self.out):
            scores = scores_of(self.out)
            publish(self.out, scores, compare=False, verbose=self.verbose)
        return 1 if merged.missing or scores.skipped else 0

    def _merge_sweeps(self) -> int:
        from carecontact.report.words import listed
        from carecontact.runs.merge import merge_sweeps
        from carecontact.runs.sweep import CELLS

        merged = merge_sweeps(self.out, self.runs)
        self._say(f", {counted(len(merged), 'cell')}", list(merged.values()))
        status = 0
        for name, cell in merged.items():
            folder = self.out / CELLS / name
            if any(folder.glob("*.h5")):
                store(folder, rescore=False)
            run = stored(folder)
            lines = [f"skipped {file}: {why}" for file, why in run.skipped.items()] if run else []
            if cell.missing:
                lacking = counted(len(cell.missing), "planned trial has", "planned trials have")
                lines.append(f"{lacking} no recording: {listed(cell.missing)}")
            for line in lines:
                print(f"{folder}: {line}")
                status = 1
        print(f"for the table: carecontact sweep PLAN.toml --out {shlex.quote(str(self.out))} --table-only")
        return status

    def _say(self, cells: str, merged: list[Merged]) -> None:
        copied, already = (sum(getattr(each, name) for each in merged) for name in ("copied", "already"))
        known = f", {already} were there already" if already else ""
        parts, recordings = counted(len(self.runs), "part"), counted(copied, "recording")
        print(f"{parts}{cells}: {recordings} copied into {self.out}{known}", flush=True)

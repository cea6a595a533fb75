"""Runs the missing trials of a folder on an engine, as many at a time as the machine bears, and repeats what died."""

from __future__ import annotations

import shutil
import tempfile
import time
from collections.abc import Callable, Collection, Generator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from carecontact.errors import ConfigError, ExhaustedError, StorageError, counted
from carecontact.interface.policy import PolicyCard
from carecontact.protocol.protocol import TrialSpec
from carecontact.recording.file import TEMPORARY, no_space
from carecontact.recording.reason import reason_of
from carecontact.recording.schema import EndReason, Recording
from carecontact.running.engine import EngineName, RunSettings, check_setup, setup_of
from carecontact.running.machine import check_ready
from carecontact.running.pace import check_pace, late_in
from carecontact.running.workers import ROOM_BYTES, WORKER_COMMAND, Launcher, Workers
from carecontact.runs.identity import identity_of
from carecontact.runs.lock import LOCK, folder_lock
from carecontact.runs.manifest import MANIFEST, Purpose, Survey, runs_beside, salted, survey, write_manifest
from carecontact.serving.conversation import WAIT_REPORT_S, PolicySetup
from carecontact.serving.sandbox import remove_abandoned_folders
from carecontact.system import REMEDY, is_exhausted

if TYPE_CHECKING:
    from carecontact.running.ray_engine import RayTrials

WORK_PREFIX = ".running-"
"""Begins the name of the hidden folder in a run's folder where its trials are written until they are finished."""
EventKind = Literal["kept", "redo", "started", "waiting", "finished", "warned"]
POLL_S = 0.05
START_PAUSE_S = 1.0
"""Time [s] after which a trial that could not begin is tried again."""
LACKING_ALONE_S, LACKING_S = 30.0, 600.0
"""How long [s] trials may fail to begin, without one that ends, before the run stops: while none runs, and while some
do, whose policies may be the cause."""
DEFAULT_TRIAL_LIMIT_S = 14400.0
"""Limit of a trial's wall time [s]. Only a harness that hangs reaches it: a policy has an hour for all its calls
(``BUDGET_S``), which leaves 7 s for each of the 1,500 observations that it can request."""


def remove_abandoned(out: Path) -> None:
    """Remove what a killed command left in ``out``. Call it where no other command can be at work there."""
    for folder in out.glob(f"{WORK_PREFIX}*"):
        shutil.rmtree(folder, ignore_errors=True)
    for file in out.glob(f".*{TEMPORARY}"):
        file.unlink(missing_ok=True)


def check_engine(name: EngineName, *policies: PolicySetup, gpus: float) -> str:
    """Return a warning about what the engine opens to the policies of this command, or nothing."""
    if name == "local":
        if gpus:
            raise ConfigError("--gpus: only --engine ray reserves GPUs; on one machine every trial may use all of them")
        return ""
    if gpus < 0:
        raise ConfigError(f"--gpus {gpus:g}: must be 0 or more")
    if any(policy.record is not None for policy in policies):
        raise ConfigError("--record: not with --engine ray, whose nodes write no common file; record on one machine")
    from carecontact.running.ray_engine import asks_for_a_token, connect

    connect(*(policy.ref for policy in policies))
    if all(policy.ref.kind == "remote" for policy in policies) or asks_for_a_token():
        return ""
    return (
        "this Ray cluster takes orders from any process that reaches its ports, and a policy does; set "
        "RAY_AUTH_MODE=token (docs/machines.md)"
    )


def engine_of(name: EngineName, run: RunSettings, launcher: Launcher, *, gpus: float) -> Workers | RayTrials:
    """``gpus``: share of a GPU that a cluster reserves for each trial. Raises as ``check_engine``."""
    check_engine(name, run.policy, gpus=gpus)
    if name == "local":
        return Workers(run, launcher)
    from carecontact.running.ray_engine import RayTrials

    return RayTrials(run, gpus=gpus)


@dataclass(frozen=True, kw_only=True)
class TrialEvent:
    kind: EventKind
    trial_id: str
    done: int
    """Trials that need no more work, this one included."""
    total: int
    ended: EndReason | None = None
    message: str | None = None
    """The line of the failure that says why, why a file is run again, for how long a policy has been silent, or what is
    suspect about the first answer of the run."""


@dataclass(frozen=True, kw_only=True)
class RunSummary:
    planned: frozenset[str]
    ended: dict[str, EndReason]
    """Every planned trial that has a recording."""
    ran: tuple[str, ...]
    kept: tuple[str, ...]
    unreached: str | None
    """Why the run stopped before its end: the policy's server could not be reached, or a package is missing; None: it
    is complete."""
    late: dict[str, int]
    """Trial that this command ran with a pace -> how many of its observations came late, where any did."""
    most_at_once: int
    """Trials that ran at the same time; of a policy with an address, its connections."""
    wall_s: float

    def followed_by(self, later: RunSummary) -> RunSummary:
        """Return the summary of a command that then ran some of these trials again."""
        ended = {trial: how for trial, how in self.ended.items() if trial not in later.planned}
        late = {trial: number for trial, number in self.late.items() if trial not in later.planned}
        ran, kept = (tuple(t for t in trials if t not in later.planned) for trials in (self.ran, self.kept))
        return replace(
            later,
            planned=self.planned,
            ended=ended | later.ended,
            ran=ran + later.ran,
            kept=kept + later.kept,
            late=late | later.late,
            most_at_once=max(self.most_at_once, later.most_at_once),
            wall_s=self.wall_s + later.wall_s,
        )


def run_trials(specs: Sequence[TrialSpec], *, out: Path, jobs: int | None = None, **options: Any) -> RunSummary:
    """Run what is missing in ``out``, ``jobs`` trials at once; every trial has a recording afterwards. A trial of which
    a signal killed a process is run once more (``running.lost``). A worker that dies without a recording gets one that
    says how it died. If a policy's server stays out of reach, no further trial begins; those that run end, and those
    that did not begin have no recording. On KeyboardInterrupt the workers are killed and finished trials stay."""
    check_jobs(jobs)
    with open_run(specs, out=out, **options) as run:
        while run.advance(jobs):
            time.sleep(POLL_S)
    return run.summary()


@contextmanager
def open_run(
    specs: Sequence[TrialSpec],
    *,
    out: Path,
    policy: PolicySetup | None = None,
    card: PolicyCard | None = None,
    weights: Path | None = None,
    pace_s: float | None = None,
    engine: EngineName = "local",
    gpus: float = 0.0,
    retry_failed: bool = False,
    suspects: Collection[str] = (),
    trial_limit_s: float = DEFAULT_TRIAL_LIMIT_S,
    on_event: Callable[[TrialEvent], None] = lambda event: None,
    worker_command: Sequence[str] = WORKER_COMMAND,
    launcher: Launcher | None = None,
    purpose: Purpose = "run",
    whole: Sequence[str] = (),
) -> Generator[Run]:
    """Keep the folder of a run for the trials that it still lacks; the end of the block kills those that run.

    Args:
        policy: how the policy of all trials is reached; default: as its name in the trials alone says.
        card: what the policy showed; of a policy on another host it decides whether this is the same run.
        weights: folder with the weights of the protocol's segmenter.
        pace_s: wall time [s] for each control period, as the policy sees it; None: as fast as can be.
        engine: where the trials run.
        gpus: share of a GPU that a cluster reserves for each trial.
        suspects: trials whose recording may be damaged in an array, and is read whole for that.
        launcher: starts the workers of other runs of this command, too, if it has the same ``worker_command``.
        whole: ids of all trials of the run of which ``specs`` are a part.
    """
    check_pace(pace_s)
    if not specs:
        raise ConfigError("no trial to run")
    setup = policy or setup_of(specs[0])
    check_setup(specs[0], setup)
    identity = identity_of(specs[0], search_path=setup.search_path, language=setup.language, card=card)
    with folder_lock(out, make=True), ExitStack() as opened:
        found = survey(specs, out=out, retry_failed=retry_failed, identity=identity, suspects=suspects)
        specs = salted(specs, out=out)
        if launcher is None or launcher.command != tuple(worker_command):
            launcher = Launcher(worker_command, forks=len(specs) > len(found.keep) + 1)
            opened.callback(launcher.close)
        if engine == "local" and len(specs) > len(found.keep):
            launcher.begin()
            check_ready()
        try:
            remove_abandoned(out)
            write_manifest(specs, out=out, identity=identity, purpose=purpose, whole=whole)
        except OSError as error:
            raise ConfigError(f"{out}: cannot be written to: {error.strerror}") from None
        remove_abandoned_folders()
        work = Path(opened.enter_context(tempfile.TemporaryDirectory(prefix=WORK_PREFIX, dir=out)))
        settings = RunSettings(
            out=out,
            work=work,
            policy=replace(setup, closed=(*setup.closed, *runs_beside(out))),
            identity=identity,
            weights=weights,
            pace_s=pace_s,
            trial_limit_s=trial_limit_s,
            command=None if launcher.command == WORKER_COMMAND else launcher.command,
            killed=found.killed,
        )
        running = engine_of(engine, settings, launcher, gpus=gpus)
        try:
            yield Run(specs, found, running, out, on_event)
        except FileNotFoundError:
            if work.is_dir():
                raise
            raise StorageError(
                f"{out}: somebody removed or moved this folder while its trials ran; give the same command again"
            ) from None
        finally:
            running.kill_all()


class Run:
    """The trials of one run: which begins when, and the reports of their progress; an engine carries them out."""

    def __init__(
        self,
        specs: Sequence[TrialSpec],
        found: Survey,
        engine: Workers | RayTrials,
        out: Path,
        on_event: Callable[[TrialEvent], None],
    ) -> None:
        self.ended: dict[str, EndReason] = dict(found.keep)
        self.unreached: str | None = None
        self.late: dict[str, int] = {}
        self._stopped: StorageError | ExhaustedError | None = None
        self._found, self._total, self._out = found, len(specs), out
        self.engine, self._on_event = engine, on_event
        self._began = self._next_start = time.monotonic()
        self._next_look = self._began + WAIT_REPORT_S
        self._answered, self._most = False, 0
        self._lacking_since: float | None = None
        for trial_id, how in found.keep.items():
            self._report("kept", trial_id, ended=how)
        for trial_id, why in found.redo.items():
            self._report("redo", trial_id, message=why)
        self._planned = frozenset(spec.trial_id for spec in specs)
        self._waiting = [spec for spec in specs if spec.trial_id not in found.keep]

    @property
    def running(self) -> int:
        return len(self.engine.running)

    @property
    def waiting(self) -> int:
        return len(self._waiting)

    def advance(self, jobs: int | None) -> bool:
        """Take the trials that have ended, begin others until ``jobs`` run, and return at once whether any are left."""
        self._take_finished()
        while (
            self._waiting
            and time.monotonic() >= self._next_start
            and self.running < (self.engine.slots() if jobs is None else jobs)
        ):
            if shutil.disk_usage(self._out).free < ROOM_BYTES * (self.running + 1):
                free = no_space(self._out, f"less than {ROOM_BYTES >> 20} MB are free for each trial")
                self._stop(StorageError(str(free)))
                break
            spec = self._waiting.pop(0)
            # First, because the fork server takes a second to start.
            self._report("started", spec.trial_id)
            try:
                self.engine.start(spec)
            except OSError as error:
                if not is_exhausted(error):
                    raise
                self._start_later(spec, f"no process for it: {error.strerror or error}")
                break
            self._most = max(self._most, self.running)
        self._report_silence()
        if self._waiting or self.running:
            return True
        if self._stopped is not None:
            done = f"the run stops with {len(self.ended)} of {counted(self._total, 'trial')} done"
            raise type(self._stopped)(f"{done}: {self._stopped} to continue")
        return False

    def summary(self) -> RunSummary:
        return RunSummary(
            planned=self._planned,
            ended=self.ended,
            ran=tuple(trial_id for trial_id in self.ended if trial_id not in self._found.keep),
            kept=tuple(self._found.keep),
            unreached=self.unreached,
            late=self.late,
            most_at_once=self._most,
            wall_s=time.monotonic() - self._began,
        )

    def _again(self, spec: TrialSpec) -> None:
        if self._stopped is None:
            self._waiting.insert(0, spec)

    def _start_later(self, spec: TrialSpec, why: str) -> None:
        """Wait with a trial: those that run may use what it needs. Where that lasts, begin no more."""
        self._again(spec)
        now = time.monotonic()
        self._lacking_since = now if self._lacking_since is None else self._lacking_since
        if now - self._lacking_since > (LACKING_S if self.running else LACKING_ALONE_S):
            self._stop(ExhaustedError(f"a trial could not begin: {why}; {REMEDY}"))
        elif self._waiting:
            self._report("waiting", self._waiting[0].trial_id, message=f"cannot begin yet: {why}")
        self._next_start = now + START_PAUSE_S

    def _stop(self, why: StorageError | ExhaustedError) -> None:
        self._stopped = why
        self._waiting.clear()

    def _report_silence(self) -> None:
        """Report policies that are silent, at most once every WAIT_REPORT_S."""
        if time.monotonic() < self._next_look:
            return
        self._next_look = time.monotonic() + WAIT_REPORT_S
        for trial_id, line in self.engine.waiting().items():
            self._report("waiting", trial_id, message=line)

    def _take_finished(self) -> None:
        for done in self.engine.finished():
            if done.kind in ("lost", "recorded"):
                self._lacking_since = None
            if done.kind == "unreached":
                self.unreached = done.why
                self._waiting.clear()
            elif done.kind == "unstored":
                self._stop(StorageError(done.why))
            elif done.kind == "lacked":
                self._start_later(done.spec, done.why)
            elif done.recording is None:
                self._again(done.spec)
                self._report("redo", done.spec.trial_id, message=done.why)
            else:
                self._take(done.spec.trial_id, done.recording, done.warnings)

    def _take(self, trial_id: str, recording: Recording, warnings: Sequence[str] | None) -> None:
        header = recording.header
        self.ended[trial_id] = header.ended
        if late := late_in(recording):
            self.late[trial_id] = late
        why = reason_of(header.failure) if header.failure else None
        self._report("finished", trial_id, ended=header.ended, message=why)
        if warnings is not None and not self._answered:
            self._answered = True
            for text in warnings:
                self._report("warned", trial_id, message=text)

    def _report(self, kind: EventKind, trial_id: str, **more: Any) -> None:
        self._on_event(TrialEvent(kind=kind, trial_id=trial_id, done=len(self.ended), total=self._total, **more))


def check_jobs(jobs: int | None) -> None:
    if jobs is not None and jobs < 1:
        raise ConfigError(f"jobs {jobs}: must be at least 1")


def move_aside(out: Path) -> Path | None:
    """Rename the folder of a run to ``NAME.before-1``, or the next number that is free, so that its folder can begin
    again; nothing is deleted. Call it inside ``folder_lock``, whose lock does not move: lock the folder again. Returns
    the new place, or None where there is nothing to move. Raises ConfigError for a folder that is not a run, that this
    command stands in or that cannot be moved."""
    if not out.exists() or (out.is_dir() and all(path.name == LOCK for path in out.iterdir())):
        return None
    if not (out / MANIFEST).is_file():
        raise ConfigError(f"--restart: {out} is not a run: it holds no {MANIFEST}; use another --out")
    place = out.absolute()
    if Path.cwd().is_relative_to(out.resolve()):
        raise ConfigError(f"--restart: {out} is the current folder or around it; change to another folder first")
    remove_abandoned(out)
    moved = next(path for k in count(1) if not (path := place.with_name(f"{place.name}.before-{k}")).exists())
    try:
        place.rename(moved)
    except OSError as error:
        raise ConfigError(f"--restart: {out} cannot be moved to {moved}: {error.strerror}") from None
    (moved / LOCK).unlink(missing_ok=True)
    return out.with_name(moved.name) if out.name else moved

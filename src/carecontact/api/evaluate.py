"""Trials of one policy, run and scored from Python, as `carecontact run` runs them."""

from __future__ import annotations

import inspect
import logging
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

from carecontact.api.run import Run
from carecontact.errors import ConfigError, DependencyError, PolicyError, counted
from carecontact.interface.policy import Policy, PolicyCard
from carecontact.policies.registry import is_privileged
from carecontact.protocol.load import DEFAULT_PROTOCOL, DEFAULT_SEEDS, load_protocol
from carecontact.protocol.overrides import check_accepted, overridden
from carecontact.recording.reason import reason
from carecontact.report.trial_table import write_trial_table
from carecontact.running.supervisor import TrialEvent, run_trials
from carecontact.runs import score_run, write_scores
from carecontact.runs.identity import check_frozen
from carecontact.runs.manifest import runs_beside
from carecontact.runs.plan import check_protocol, check_rows, parse_seeds, parse_tasks, plan_trials
from carecontact.runs.scoring import beside_plan
from carecontact.serving.conversation import PolicySetup
from carecontact.serving.opening import open_policy
from carecontact.serving.serve import served

PORT = 8765
"""Port at which a policy object is served. It is always the same one, because it stands in the recordings: with another
port, another call could not go on with the same run."""


def evaluate(
    policy: str | type[Any] | Callable[..., Any] | Policy,
    *,
    out: str | Path,
    protocol: str = DEFAULT_PROTOCOL,
    level: str | None = None,
    tasks: str | Iterable[str] = "all",
    seeds: str | int | Iterable[int] = DEFAULT_SEEDS,
    arguments: Mapping[str, object] | None = None,
    overrides: Mapping[str, object] | None = None,
    allow_rejected: bool = False,
    jobs: int | None = None,
    retry_failed: bool = False,
    port: int = PORT,
    on_event: Callable[[TrialEvent], None] = lambda event: None,
) -> Run:
    """Run the trials that are missing in ``out``, score them, and return the run.

    Args:
        policy: one of three things. A text is what `carecontact run --policy` takes: a name, ``module:Class`` or an
            address. A class or function of a module runs in processes of its own, isolated, as ``module:Class`` does.
            An object with ``card``, ``reset`` and ``act`` stays in this process and is served on the loopback
            interface; it is not isolated, and its trials run one after another.
        out: folder for recordings, results.json and results.parquet (the table only where pyarrow is installed).
        protocol: id of a shipped protocol, or a .toml file.
        level: name of a level, for a protocol that has levels; without one, L2.
        tasks: ``"T1,T2"``, ``"T1-T7"``, ``"all"``, or task ids.
        seeds: ``"0-4"``, ``"all"``, a seed, or seeds.
        arguments: for the constructor or factory; texts that its annotations convert, so not for an object.
        overrides: field of the protocol by its dotted name -> value in its place; every output names it.
        allow_rejected: whether tissue may be used whose calibration was rejected; every report then says so.
        jobs: trials that run at once; by default one per core, and one for a policy object.
        retry_failed: run again the trials in which the policy crashed or the harness failed.
        port: port at which a policy object is served; 0 chooses a free one, but then no later call can go on with the
            same run.
        on_event: called with what becomes of each trial.

    Raises ConfigError for anything given wrongly, for a policy that does not start, and for a server that stays out of
    reach. A trial in which the policy crashes is a result.
    """
    rules = overridden(check_frozen(protocol, load_protocol(protocol, level=level), unfrozen=False), overrides or {})
    check_protocol(rules)
    check_rows(rules)
    check_accepted(rules, allowed=allow_rejected)
    task_ids = parse_tasks(_listed("tasks", tasks), protocol=rules)
    seed_numbers = parse_seeds(_listed("seeds", seeds), protocol=rules)
    place = Path(out)
    given = {name: str(value) for name, value in (arguments or {}).items()}
    with _reached(policy, given, port=port, jobs=jobs) as (text, search_path):
        setup = PolicySetup.of(text, search_path=search_path, arguments=given)
        closed = replace(setup, closed=tuple(runs_beside(place)))
        card = _card(closed, deadline_s=rules.phases.first_call_deadline_s)
        summary = run_trials(
            plan_trials(protocol=rules, policy=setup.ref.text, tasks=task_ids, seeds=seed_numbers, arguments=given),
            out=place,
            policy=setup,
            card=card,
            jobs=jobs if _is_made_elsewhere(policy) else 1,
            retry_failed=retry_failed,
            on_event=on_event,
        )
    if summary.unreached is not None:
        raise ConfigError(f"the run stops with {counted(len(summary.ended), 'trial')} done: {summary.unreached}")
    scored = beside_plan(place, score_run(place))
    write_scores(place, scored)
    with suppress(DependencyError):
        write_trial_table(place, scored.scores)
    return Run(path=place, scored=scored)


def _listed(name: str, given: object) -> str:
    """``["T1", "T2"]`` -> ``T1,T2``, which the planner reads and checks. Raises ConfigError for what is no list."""
    if not isinstance(given, str | int | Iterable):
        raise ConfigError(f"{name}={given!r}: expected a text, a number or a list")
    return str(given) if isinstance(given, str | int) else ",".join(map(str, given))


@contextmanager
def _reached(
    policy: object, arguments: Mapping[str, str], *, port: int, jobs: int | None
) -> Iterator[tuple[str, tuple[str, ...]]]:
    """Within the block, the policy can be reached. Yields its reference and the folders in which to look for it."""
    if isinstance(policy, str):
        yield policy, (str(Path.cwd()),)
    elif _is_made_elsewhere(policy):
        yield _importable(policy)
    else:
        _check_object(policy, arguments, jobs)
        with served(cast(Policy, policy), port=port) as address:
            yield address, ()


def _is_made_elsewhere(policy: object) -> bool:
    """Whether the trials make the policy themselves, in processes of its own or on another host."""
    return isinstance(policy, str) or inspect.isclass(policy) or inspect.isfunction(policy)


def _check_object(policy: object, arguments: Mapping[str, str], jobs: int | None) -> None:
    """Raises ConfigError for what is no policy, and for options that an object cannot be given."""
    lacking = [name for name in ("card", "reset", "act") if not hasattr(policy, name)]
    if lacking:
        kind = type(policy).__name__
        raise ConfigError(f"policy: the {kind} object has no {' and no '.join(lacking)}; a policy has card, reset, act")
    if arguments:
        raise ConfigError("arguments: a policy object is constructed already; give its class with arguments instead")
    if jobs not in (None, 1):
        raise ConfigError(f"jobs={jobs}: a policy object answers one trial at a time; give its class for more")


def _importable(made: Any) -> tuple[str, tuple[str, ...]]:
    """``module:Class`` and the folder in which the module lies.

    Raises ConfigError for what another process cannot import by its name.
    """
    name, module = made.__qualname__, sys.modules.get(made.__module__)
    file = getattr(module, "__file__", None)
    if not name.isidentifier() or file is None:
        raise ConfigError(
            f"policy {name}: another process cannot import it, because it was defined in a function or in a session "
            "without a file; put it into a module, or give an object of it"
        )
    if made.__module__ == "__main__":
        return f"{Path(file).stem}:{name}", (str(Path(file).resolve().parent),)
    root = Path(file).resolve().parents[made.__module__.count(".") + (Path(file).name == "__init__.py")]
    return f"{made.__module__}:{name}", (str(root),)


def _card(setup: PolicySetup, *, deadline_s: float) -> PolicyCard | None:
    """Start the policy once, because otherwise every trial would fail in the same way; a privileged one has no process
    to start."""
    if is_privileged(setup.ref):
        return None
    conversation = open_policy(setup, first_deadline_s=deadline_s, deadline_s=deadline_s)
    conversation.on_wait, conversation.patient = logging.getLogger(__name__).warning, True
    try:
        with conversation:
            return conversation.start()
    except PolicyError as error:
        raise ConfigError(f"policy {setup.ref} does not start: {reason(str(error))}") from None

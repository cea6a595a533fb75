"""``carecontact run``: plan, run what is missing, score, report."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from carecontact.cli.policy_name import check_policy
from carecontact.cli.progress import progress
from carecontact.cli.score import report, rescore
from carecontact.protocols import load_protocol
from carecontact.trials.plan import parse_seeds, parse_tasks, plan_trials
from carecontact.trials.supervisor import run_trials

if TYPE_CHECKING:
    from carecontact.trials.supervisor import RunSummary

POLICY_PATH = "CARECONTACT_POLICY_PATH"
"""Tells a trial's process where ``module:Class`` policies are looked for."""


def run(
    *,
    policy: str,
    out: Path,
    tasks: str,
    seeds: str,
    protocol: str,
    jobs: int | None,
    retry_failed: bool,
) -> int:
    """Exit status 1 if the harness failed in any trial; a policy that fails is a result."""
    rules = load_protocol(protocol)
    task_ids, seed_list = parse_tasks(tasks, protocol=rules), parse_seeds(seeds, protocol=rules)
    folder = Path.cwd()
    check_policy(policy, search_path=folder, deadline_s=rules.phases.first_call_deadline_s)
    specs = plan_trials(protocol=rules, policy=policy, tasks=task_ids, seeds=seed_list)
    print(f"{policy}: {len(specs)} trial(s) of {rules.id} into {out}", flush=True)
    with progress() as on_event:
        summary = run_trials(
            specs,
            out=out,
            jobs=jobs,
            retry_failed=retry_failed,
            environment={POLICY_PATH: str(folder)},
            on_event=on_event,
        )
    # New trials change the summary as they should; only a run that had nothing to do can show an unexpected change.
    report(out, run=rescore(out, compare=not summary.ran))
    return 1 if _tell_failures(summary, out=out) else 0


def _tell_failures(summary: RunSummary, *, out: Path) -> int:
    """Number of trials that the harness failed to run."""
    by_end = {end: [t for t, e in summary.ended.items() if e == end] for end in ("process_failure", "harness_error")}
    for end, whose in (("process_failure", "the policy's process"), ("harness_error", "the harness")):
        if by_end[end]:
            print(f"{len(by_end[end])} trial(s) failed in {whose}; see {out / (by_end[end][0] + '.log')}")
    if any(by_end.values()):
        print("the same command with --retry-failed runs them again")
    return len(by_end["harness_error"])

"""``carecontact run``: plan, run what is missing, score, report."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from carecontact.cli.language import language_environment
from carecontact.cli.policy_name import check_policy, public_name
from carecontact.cli.progress import progress
from carecontact.cli.score import report, rescore
from carecontact.cli.vision import chosen_vision
from carecontact.episode.vision import WEIGHTS
from carecontact.protocols import adapted, load_protocol
from carecontact.runs.freeze import check_frozen
from carecontact.runs.identity import POLICY_PATH
from carecontact.runs.plan import parse_seeds, parse_tasks, plan_trials
from carecontact.runs.preflight import check_protocol
from carecontact.trials.supervisor import check_jobs, run_trials

if TYPE_CHECKING:
    from carecontact.runs.manifest import Purpose
    from carecontact.trials.supervisor import RunSummary


def run(
    *,
    policy: str,
    out: Path,
    tasks: str,
    seeds: str,
    protocol: str,
    body: str | None = None,
    tissue: str | None = None,
    stiffness: float | None = None,
    language: str | None = None,
    record: Path | None = None,
    fast: bool = False,
    segmenter: str | None = None,
    weights: Path | None = None,
    unfrozen: bool = False,
    jobs: int | None,
    retry_failed: bool,
    purpose: Purpose = "run",
) -> int:
    """``body``, ``tissue``, ``stiffness``, ``fast``: see ``protocols.adapted``; ``segmenter``, ``weights``: see
    ``chosen_vision``; ``unfrozen``: see ``check_frozen``; ``language``, ``record``: see ``language_environment``.

    Exit status 1 if the harness failed in any trial or a recording was skipped; a policy that fails is a result."""
    check_jobs(jobs)
    policy = public_name(policy)
    loaded = check_frozen(protocol, load_protocol(protocol), unfrozen=unfrozen)
    vision = chosen_vision(loaded, segmenter=segmenter, weights=weights)
    rules = adapted(loaded, body=body, tissue=tissue, fast=fast, stiffness_n_m=stiffness, vision=vision)
    check_protocol(rules)
    task_ids, seed_list = parse_tasks(tasks, protocol=rules), parse_seeds(seeds, protocol=rules)
    folder = Path.cwd()
    spoken = language_environment(policy, language=language, record=record)
    check_policy(policy, search_path=folder, deadline_s=rules.phases.first_call_deadline_s)
    specs = plan_trials(protocol=rules, policy=policy, tasks=task_ids, seeds=seed_list)
    print(f"{policy}: {len(specs)} trial(s) of {rules.title} into {out}", flush=True)
    with progress() as on_event:
        summary = run_trials(
            specs,
            out=out,
            jobs=jobs,
            retry_failed=retry_failed,
            environment={POLICY_PATH: str(folder), WEIGHTS: str(weights.resolve()) if weights else "", **spoken},
            on_event=on_event,
            purpose=purpose,
        )
    # New trials change the summary as they should; only a run that had nothing to do can show an unexpected change.
    scores = rescore(out, compare=not summary.ran)
    report(out, run=scores)
    return 1 if _tell_failures(summary, out=out) or scores.skipped else 0


def _tell_failures(summary: RunSummary, *, out: Path) -> int:
    """Number of trials that the harness failed to run."""
    by_end = {end: [t for t, e in summary.ended.items() if e == end] for end in ("process_failure", "harness_error")}
    for end, whose in (("process_failure", "the policy's process"), ("harness_error", "the harness")):
        if by_end[end]:
            logs = [log for trial_id in by_end[end] if (log := out / f"{trial_id}.log").is_file()]
            print(f"{len(by_end[end])} trial(s) failed in {whose}" + (f"; see {logs[0]}" if logs else ""))
    if any(by_end.values()):
        print("the same command with --retry-failed runs them again")
    return len(by_end["harness_error"])

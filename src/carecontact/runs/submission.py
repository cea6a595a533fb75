"""Whether a run may stand on the board: everything that a maintainer checks before strangers read its numbers."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from dataclasses import dataclass
from math import isclose
from pathlib import Path

from carecontact.errors import ConfigError, counted
from carecontact.policies.registry import role_of
from carecontact.protocol.load import load_levels, shipped_protocols
from carecontact.protocol.lock import frozen_state
from carecontact.protocol.protocol import Protocol, TrialSpec
from carecontact.recording import Header, read_header
from carecontact.runs.identity import changed, identity_of
from carecontact.runs.manifest import MANIFEST, Manifest, read_manifest
from carecontact.runs.plan import check_not_trained_on, compact
from carecontact.runs.pooling import RunScores, check_ranked
from carecontact.runs.results_file import RESULTS_NAME
from carecontact.runs.scoring import read_scores

TEST_SEEDS = range(1000, 1027)
"""Seeds of the exam whose results are reported (docs/number.md)."""
SAME_REL = 1e-6
"""Relative difference of two scores of one recording that counts as the rounding of another machine."""
NAMED = 3


@dataclass(frozen=True, kw_only=True)
class Submission:
    folder: Path
    manifest: Manifest
    protocol: Protocol
    ranked: bool
    """Whether the protocol equals its lock; results on a draft stand apart."""
    run: RunScores
    header: Header
    """The header of the first trial that has a card."""


def check_submission(folder: Path, *, jobs: int = 1) -> Submission:
    """Check a finished run of the whole exam, and compute all of its scores again. The checks, in this order: a shipped
    protocol without changes; a policy that is neither a floor nor a ceiling; this release and its assets; all tasks
    with ``TEST_SEEDS``, published or behind a committed salt; a recording of each trial, by a trial's worker; a verdict
    on each; scores that follow from the recordings; and no person of the exam among those on whom the policy was
    trained, as far as its card says."""
    manifest = read_manifest(folder)
    if manifest is None:
        raise ConfigError(f"{folder} is not a run: it holds no {MANIFEST}; name the --out of `carecontact run`")
    protocol = _exam(folder, manifest)
    if (role := role_of(manifest.policy)) != "method":
        raise ConfigError(
            f"{folder}: {manifest.policy} is registered as {role}; floor and ceiling stand beside every entry by "
            "themselves, or with --baseline RUN"
        )
    _check_plan(folder, manifest, protocol)
    headers = {trial: read_header(folder / f"{trial}.h5") for trial in _recorded(folder, manifest)}
    _check_release(folder, manifest, protocol, headers)
    for header in headers.values():
        check_not_trained_on((header.card or {}).get("trained_on", ()), [header.spec])
    run = _scores(folder, manifest, protocol, jobs=jobs)
    first = next((header for header in headers.values() if header.card), next(iter(headers.values())))
    ranked = frozen_state(protocol) == "frozen"
    return Submission(folder=folder, manifest=manifest, protocol=protocol, ranked=ranked, run=run, header=first)


def _exam(folder: Path, manifest: Manifest) -> Protocol:
    known = {rules.name: rules for id_ in shipped_protocols() for rules in load_levels(id_).values()}
    exams = {id_: rules for id_, rules in known.items() if set(TEST_SEEDS) <= set(rules.randomization.seeds)}
    protocol = exams.get(manifest.protocol.id)
    if protocol is None:
        raise ConfigError(
            f"{folder} is a run of {manifest.protocol.id}, which is no exam of the board; valid: {', '.join(exams)}"
        )
    if overrides := manifest.protocol.overrides:
        given = ", ".join(f"{field} = {value}" for field, value in overrides.items())
        raise ConfigError(f"{folder} is a run of a changed protocol ({given}); run {protocol.name} as it is")
    if protocol.sha256 != manifest.protocol.sha256:
        here, there = protocol.sha256[:12], manifest.protocol.sha256[:12]
        raise ConfigError(
            f"{folder} is a run of other rules under the id {protocol.name} (sha256 {there}, of this release {here}); "
            "run the protocol of this release, or submit with the release of the run"
        )
    return protocol


def _check_plan(folder: Path, manifest: Manifest, protocol: Protocol) -> None:
    whole = {f"{task.id}-s{seed:03d}" for seed in TEST_SEEDS for task in protocol.tasks}
    planned = {*manifest.trials, *manifest.elsewhere}
    if planned != whole:
        differ = [f"lacks {_some(whole - planned)}"] * bool(whole - planned)
        differ += [f"also has {_some(planned - whole)}"] * bool(planned - whole)
        raise ConfigError(
            f"{folder}: its plan {' and '.join(differ)}; the exam is every task with seeds {compact(TEST_SEEDS)}, on "
            "published seeds or with --salt-file, in a folder of its own"
        )


def _recorded(folder: Path, manifest: Manifest) -> list[str]:
    if manifest.elsewhere:
        raise ConfigError(f"{folder} is one part of a run; join all parts with `carecontact merge`")
    absent = {trial for trial in manifest.trials if not (folder / f"{trial}.h5").is_file()}
    if absent:
        planned = counted(len(manifest.trials), "planned trial has", "planned trials have")
        raise ConfigError(
            f"{folder}: {len(absent)} of {planned} no recording: {_some(absent)}; give its `carecontact run` command "
            "again"
        )
    return manifest.trials


def _check_release(folder: Path, manifest: Manifest, protocol: Protocol, headers: Mapping[str, Header]) -> None:
    # Of a policy of this package, whose version is in every identity; the policy's own files are the submitter's.
    here = identity_of(
        TrialSpec(protocol=protocol, task_id=protocol.tasks[0].id, seed=0, policy="hover"), search_path=()
    )
    held = manifest.identity
    differing = {MANIFEST: here.differences(versions=held.versions, sha256=held.sha256, world=held.world)}
    for trial, header in headers.items():
        differ = here.differences(versions=header.versions, sha256=header.sha256, world=header.identity)
        differing[f"{trial}.h5"] = differ
    if name := next((name for name, differ in differing.items() if differ), ""):
        raise ConfigError(
            f"{folder}: {name} is of another release ({'; '.join(differing[name])}); run the policy with this release, "
            "or submit with the release of the run"
        )


def _scores(folder: Path, manifest: Manifest, protocol: Protocol, *, jobs: int) -> RunScores:
    """Return the scores of the recordings, once the stored ones equal them."""
    stored = read_scores(folder)
    run = read_scores(folder, rescore=True, jobs=jobs)
    if run.incomplete:
        trial, why = next(iter(run.unjudged.items()))
        raise ConfigError(f"{folder}: {run.incomplete} ({trial}: {why}); {run.completing}")
    check_ranked(run.scores, f"{folder}/")
    written = {score.trial_id: score.model_dump(mode="json") for score in stored.scores}
    for score in run.scores:
        rows = changed(written.get(score.trial_id), score.model_dump(mode="json"))
        if found := next((text for row in rows if (text := _difference(*row))), ""):
            raise ConfigError(
                f"{folder / RESULTS_NAME} does not follow from the recordings: {score.trial_id}: {found}; "
                f"`carecontact report --rescore {shlex.quote(str(folder))}` writes the scores of the recordings"
            )
        same = (score.protocol_sha256, score.overrides, score.policy, score.world.get("salt", ""))
        if same != (protocol.sha256, {}, manifest.policy, manifest.salt_sha256):
            raise ConfigError(
                f"{folder}: {score.trial_id}.h5 has another policy, protocol or salt than {MANIFEST}; submit the "
                "folder as `carecontact run` left it"
            )
    return run


def _difference(place: str, stored: object, again: object) -> str:
    """Return how two values of one recording differ, if by more than rounding."""
    if isinstance(stored, float) and isinstance(again, float):
        if isclose(stored, again, rel_tol=SAME_REL, abs_tol=1e-9):
            return ""
        return f"{place} is {stored:g}, and {again:g} when it is computed again"
    return f"{place or 'its scores'} is {stored!s:.60}, and {again!s:.60} when it is computed again"


def _some(trials: set[str]) -> str:
    more = len(trials) - NAMED
    return ", ".join(sorted(trials)[:NAMED]) + (f" and {more} more" if more > 0 else "")

"""An entry of the board: what a submitted run passes, beside floor and ceiling, as one JSON object."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Iterable, Sequence
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from carecontact.cli.answers import Answer, Part
from carecontact.recording import open_recording
from carecontact.report.baselines import ALL, floor_of, role_in
from carecontact.report.comparison import trials_by_key
from carecontact.runs.plan import compact
from carecontact.runs.pooling import judged, rate_of
from carecontact.runs.results_file import harmless_share
from carecontact.runs.submission import Submission
from carecontact.scoring.result import TrialScore

Kind = Literal["vision", "trained-on-simulation", "served"]
"""What a reader has to know of a method: it sees pictures and was not trained on simulated persons; it was trained on
them; or it runs behind an address, where no one else can look into it."""
Seconds = float | None
Text = Annotated[str, Field(pattern=r"^[^`\r\n]{1,500}$")]
Name = Annotated[str, Field(pattern=r"^[^\s<>|\[\]{}`*\\][^<>|\[\]{}`*\\\r\n]{0,59}$")]
"""Strangers write entries, and pages show them: a name holds nothing that Markdown or HTML would take for its own."""


class Share(Part):
    n: int
    of: int
    pc: float | None
    """Percentage; null where ``of`` is 0."""
    pc_ci95: tuple[float, float]
    """95 % interval [percent], over persons; of ``harmless``, Wilson's over trials."""


class Passes(Part):
    """Trials that one policy passes: safety-gated ones (docs/scores.md)."""

    whole: Share
    scrubs: Share
    others: Share
    """Touches and pushes."""
    harmless: Share
    """Harmless trials, of those with at least 1 s of contact on the named region (``harmless@1``)."""
    tasks: dict[str, Share]


class Beside(Part):
    policy: str
    seeds: str
    """Seeds of its trials: those of the entry, or, where these are not known, those of the kept scores."""
    passes: Passes


class BoardLevel(Part):
    """What the policy passes on one level of the exam."""

    protocol: Annotated[str, Field(pattern=r"^[A-Za-z0-9._ -]{1,80}$")]
    """Id of the protocol with its level."""
    protocol_sha256: str
    ranked: bool
    """Whether the protocol is frozen. A draft of the exam ranks nothing, and stands apart."""
    seeds: str
    salt_sha256: str
    """Hash of the secret of a salted run; empty for published seeds."""
    salt_revealed: bool
    passes: Passes
    success: Share
    region_correct: Share
    failures: dict[str, int]
    """Failure mode -> trials (docs/scores.md)."""
    causes: dict[str, int]
    """Attributed cause -> trials."""
    floor: Beside | None
    """The blind baseline that passes most; null where none ran under these rules."""
    ceiling: Beside | None
    policy_s: Seconds
    """Median over trials of the wall time that the policy took [s]; no hash covers it."""
    trial_s: Seconds
    """Median wall time of a trial [s], the policy's included; no hash covers it."""
    recordings_sha256: str
    """Hash over the canonical hashes of all recordings (``recordings_sha256``)."""


class BoardEntry(Answer):
    """A policy on the board, as `carecontact submit` writes it into board/NAME.json."""

    kind: Annotated[Literal["carecontact-board-entry-1"], Field(alias="schema")] = "carecontact-board-entry-1"
    name: Name
    """Name of the method, at most 60 characters."""
    link: Annotated[str, Field(pattern=r"^https?://[^\s<>\"'`|()\[\]]{1,200}$")] | None
    """Address of a paper, code or report; None for a shipped policy."""
    method: Kind
    policy: Text
    """The policy as the command line names it."""
    policy_arguments: dict[Text, Text]
    policy_sha256: str | None
    """Hash of its module; null for a policy of the package or of another host."""
    origin: Literal["isolated", "served"]
    receives: list[str]
    """Modalities that its card requests."""
    trained_on: list[str]
    """The persons on whom it was trained, as far as its card says."""
    release: str
    levels: Annotated[list[BoardLevel], Field(min_length=1)]


def passes_of(scores: Sequence[TrialScore]) -> Passes:
    """Return what a policy passes, over its judged trials, one at least."""
    scores = judged(scores)
    tasks = sorted({score.task_id for score in scores})
    harmless = harmless_share(scores)
    return Passes(
        whole=share_of(scores),
        scrubs=share_of([s for s in scores if s.action == "scrub"]),
        others=share_of([s for s in scores if s.action != "scrub"]),
        harmless=Share(n=harmless["n"], of=harmless["of"], pc=harmless["pc"], pc_ci95=tuple(harmless["pc_ci95"])),
        tasks={task: share_of([s for s in scores if s.task_id == task]) for task in tasks},
    )


def share_of(scores: Sequence[TrialScore], field: str = "safety_gated") -> Share:
    """Return how many trials have a field of their score true, with an interval over persons."""
    rate = rate_of(scores, field)
    percent = None if rate.estimate is None else 100 * rate.estimate
    return Share(n=rate.k, of=rate.n, pc=percent, pc_ci95=(100 * rate.low, 100 * rate.high))


def best_beside(
    role: Literal["blind", "privileged"], runs: Iterable[Sequence[TrialScore]], method: Sequence[TrialScore] = ()
) -> Beside | None:
    """Return the policy of a role that passes most (``floor_of``), on the method's trials, or on all of its own if none
    is shared."""
    keys, found = trials_by_key(method), dict[str, Sequence[TrialScore]]()
    for scores in runs:
        if role_in(scores) == role:
            shared = judged(s for s in scores if (s.task_id, s.seed) in keys)
            found[scores[0].policy_title] = shared or judged(scores)
    if not found:
        return None
    best = found[floor_of(found.values())[ALL].policy]
    return Beside(policy=best[0].policy_title, seeds=compact({s.seed for s in best}), passes=passes_of(best))


def level_of(submission: Submission, beside: Sequence[Sequence[TrialScore]]) -> BoardLevel:
    """Return what a checked run passes. ``beside``: scores of the runs of which floor and ceiling are chosen."""
    scores, manifest = submission.run.scores, submission.manifest
    policy_s, trial_s = _costs(submission)
    return BoardLevel(
        protocol=submission.protocol.name,
        protocol_sha256=submission.protocol.sha256,
        ranked=submission.ranked,
        seeds=compact({score.seed for score in scores}),
        salt_sha256=manifest.salt_sha256,
        salt_revealed=bool(manifest.salt),
        passes=passes_of(scores),
        success=share_of(scores, "c3_success"),
        region_correct=share_of(scores, "region_correct"),
        failures=dict(sorted(Counter(s.failure_mode for s in scores if s.failure_mode).items())),
        causes=dict(sorted(Counter(s.attribution for s in scores if s.attribution).items())),
        floor=best_beside("blind", beside, scores),
        ceiling=best_beside("privileged", beside, scores),
        policy_s=policy_s,
        trial_s=trial_s,
        recordings_sha256=recordings_sha256(scores),
    )


def recordings_sha256(scores: Iterable[TrialScore]) -> str:
    """Return the sha256 over a line ``TRIAL SHA256`` for each recording, in the order of the trials."""
    lines = sorted(f"{score.trial_id} {score.recording_sha256}\n" for score in scores)
    return hashlib.sha256("".join(lines).encode()).hexdigest()


def _costs(submission: Submission) -> tuple[Seconds, Seconds]:
    found: dict[str, list[float]] = {"wall/act_s": [], "wall/seconds": []}
    for score in submission.run.scores:
        path = submission.folder / f"{score.trial_id}.h5"
        recording = open_recording(path, sha256=score.recording_sha256)
        for name, values in found.items():
            if name in recording:
                values.append(float(recording[name].sum()))
    policy_s, trial_s = (round(float(np.median(values)), 3) if values else None for values in found.values())
    return policy_s, trial_s

"""``carecontact submit``: checks a finished run, and writes its entry of the board."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, get_args

import tyro

from carecontact.cli.console import print_answer
from carecontact.cli.groups import JsonGroup, make_folder_of
from carecontact.errors import ConfigError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from carecontact.cli.board import BoardEntry, BoardLevel
    from carecontact.runs.pooling import RunScores
    from carecontact.runs.submission import Submission
    from carecontact.scoring.result import TrialScore

EXPECTED = {
    "name": "at most 60 characters, none of them <>|[]{}`* or a backslash",
    "link": "an address that begins with http:// or https://, without spaces, quotes or brackets",
}
"""Option -> its valid values."""


@dataclass(frozen=True, kw_only=True)
class Submit:
    """Check a finished run of the whole exam as a maintainer does, with all scores computed again from the recordings,
    and write its entry of the board. See docs/board.md."""

    runs: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="RUN [RUN ...]")]
    """The --out folders of runs of one policy, one for each level of the exam."""
    name: str
    """Name of the method on the board, at most 60 characters."""
    link: str | None = None
    """Address of its paper, code or report: http:// or https://. Required, except for a shipped policy."""
    out: Path
    """The file to write, board/NAME.json; NAME of a to z, digits and hyphens."""
    kind: Literal["vision", "trained-on-simulation", "served"] | None = None
    """Kind of the method: `vision` sees pictures and was not trained on simulated persons, `trained-on-simulation` was,
    and `served` runs behind an address. Default: what origin and card say."""
    baseline: Annotated[tuple[Path, ...], tyro.conf.arg(metavar="RUN...")] = ()
    """Folders of runs of blind baselines and of the oracle on the same persons, scored again as well. A salted run has
    no floor and no ceiling without them."""
    jobs: int | None = None
    """Number of processes that compute scores; default: one per core, or fewer."""
    output: JsonGroup = field(default_factory=JsonGroup)

    def __call__(self) -> int:
        from pydantic import ValidationError

        from carecontact.cli.board import BoardEntry, level_of
        from carecontact.policies.registry import SHIPPED
        from carecontact.recording.file import replace_file

        self._check_out()
        found = [self._checked(run) for run in self.runs]
        _check_one_policy(found)
        named = [_scored(path) for path in self.baseline]
        first, scores = found[0], found[0].run.scores
        if self.link is None and scores[0].policy not in SHIPPED:
            raise ConfigError(f"--link: {scores[0].policy} is not shipped; expected {EXPECTED['link']}")
        card = first.header.card or {}
        facts: dict[str, object] = {
            "name": self.name,
            "link": self.link,
            "method": self._kind(first),
            "policy": scores[0].policy,
            "policy_arguments": scores[0].policy_arguments,
            "policy_sha256": first.manifest.identity.policy_sha256,
            "origin": first.header.origin,
            "receives": list(card.get("modalities", ())),
            "trained_on": list(card.get("trained_on", ())),
            "release": first.manifest.identity.versions["carecontact"],
            "levels": [level_of(each, _beside(each, named)) for each in found],
        }
        try:
            entry = BoardEntry.model_validate(facts)
        except ValidationError as error:
            place = str(error.errors()[0]["loc"][0])
            valid = EXPECTED.get(place, "one line of at most 500 characters without a backtick")
            raise ConfigError(f"--{place} {facts[place]!s:.80}: expected {valid}") from None
        replace_file(self.out, f"{entry.model_dump_json(indent=1)}\n".encode())
        for level in entry.levels:
            print(_line(entry, level))
        print(f"entry: {self.out}")
        if self.output.json:
            print_answer(entry)
        return 0

    def _check_out(self) -> None:
        if not self.runs:
            raise ConfigError("submit: name the --out folder of a run of the whole exam")
        if not re.fullmatch(r"[a-z0-9][a-z0-9-]*\.json", self.out.name):
            raise ConfigError(f"--out {self.out}: expected board/NAME.json, with NAME of a to z, digits and hyphens")
        if self.out.exists():
            raise ConfigError(f"--out {self.out}: exists already; take another name, or remove your earlier entry")
        make_folder_of(self.out)

    def _checked(self, run: Path) -> Submission:
        from carecontact.audit.salt import verify_salt
        from carecontact.cli.publish import processes
        from carecontact.running.supervisor import check_jobs
        from carecontact.runs.lock import folder_lock
        from carecontact.runs.submission import check_submission

        check_jobs(self.jobs)
        jobs = processes(sum(1 for _ in run.glob("*.h5"))) if self.jobs is None else self.jobs
        with folder_lock(run):
            found = check_submission(run, jobs=jobs)
        if found.manifest.salt and (faults := verify_salt(run).faults):
            raise ConfigError(
                f"{run} was not made with the salt that it reveals: {faults[0]}; reveal the run's own salt"
            )
        return found

    def _kind(self, submission: Submission) -> str:
        from carecontact.cli.board import Kind

        card, served = submission.header.card or {}, submission.header.origin == "served"
        trained = card.get("trained_on", ())
        kind = self.kind or ("served" if served else "trained-on-simulation" if trained else None)
        if kind is None:
            valid = "vision or trained-on-simulation"
            raise ConfigError(f"--kind: the card does not say on whom the policy was trained; give {valid}")
        against = ""
        if kind == "served" and not served:
            against = "the policy ran in an isolated process of the run"
        elif kind == "vision" and trained:
            against = f"its card says that it was trained on {', '.join(trained)}"
        elif kind == "vision" and not card.get("modalities"):
            against = "its card requests no picture"
        if against:
            raise ConfigError(f"--kind {kind}: {against}; valid: {', '.join(k for k in get_args(Kind) if k != kind)}")
        return kind


def _check_one_policy(found: Sequence[Submission]) -> None:
    first = found[0]
    for other in found[1:]:
        one, two = ((s.run.scores[0].policy_title, s.manifest.identity.policy_sha256) for s in (first, other))
        if one != two or first.header.origin != other.header.origin:
            raise ConfigError(f"{first.folder} and {other.folder} are of different policies: {one[0]} and {two[0]}")
    names = [each.protocol.name for each in found]
    if twice := next((name for name in names if names.count(name) > 1), None):
        raise ConfigError(f"two runs are of {twice}; give one for each level")


def _scored(baseline: Path) -> RunScores:
    from carecontact.cli.publish import scores_of

    run = scores_of(baseline)
    if not run.scores:
        raise ConfigError(f"--baseline {baseline}: no recording can be scored; name the --out of a finished run")
    return run


def _beside(submission: Submission, named: Sequence[RunScores]) -> list[Sequence[TrialScore]]:
    """Return the scores that stand beside a run: those that were named and are of its level, and the kept ones."""
    from carecontact.report.baselines import check_baselines, shipped_scores_for

    level = submission.protocol.name
    own = [run for run in named if run.scores[0].protocol_id == level]
    check_baselines(submission.run, own)
    kept, _ = shipped_scores_for(submission.run, own)
    return [run.scores for run in (*own, *kept)]


def _line(entry: BoardEntry, level: BoardLevel) -> str:
    rows = [(f"{entry.name} passes", level.seeds, level.passes)]
    both = (("floor", level.floor), ("ceiling", level.ceiling))
    rows += [(f"{what} {each.policy}", each.seeds, each.passes) for what, each in both if each]
    text = "; ".join(
        f"{name} {passes.whole.n} of {passes.whole.of} ({passes.whole.pc:.0f} %)"
        + ("" if seeds == level.seeds else f", seeds {seeds}")
        for name, seeds, passes in rows
    )
    return f"{level.protocol}: {text}" + ("" if level.ranked else "; a draft exam, which ranks nothing")

"""The scores of one run, from whatever they were read or computed."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

from carecontact.errors import ConfigError, counted
from carecontact.runs.pooling import check_one_run, incomplete, judged, unjudged, with_names
from carecontact.scoring.result import TrialScore


@dataclass(frozen=True, kw_only=True)
class RunScores:
    scores: list[TrialScore]
    """The scores in the order of the file names."""
    skipped: dict[str, str] = field(default_factory=dict[str, str])
    """File name -> why it was not scored."""
    versions: dict[str, list[str]] = field(default_factory=dict[str, list[str]])
    """Package -> every version that the scored recordings name, and those of the packages whose metrics scored them;
    more than one means a mixed run."""
    missing: tuple[str, ...] = ()
    """Trials that were planned and have no score; where no plan is known, none."""
    elsewhere: tuple[str, ...] = ()
    """Trials of the other parts of the run of which this is a part (``run --shard``)."""

    @cached_property
    def unjudged(self) -> dict[str, str]:
        """Planned trial -> why it has no verdict; empty for a complete run."""
        return unjudged(self.scores, skipped=self.skipped, missing=self.missing, elsewhere=self.elsewhere)

    @property
    def incomplete(self) -> str:
        """``incomplete, 15 of 18 planned trials have a verdict``; empty for a complete run."""
        return incomplete(len(judged(self.scores)), self.unjudged)

    @property
    def completing(self) -> str:
        """What makes an incomplete run complete, as a part of a sentence."""
        parts = all(trial in self.elsewhere for trial in self.unjudged)
        return "join its parts with `carecontact merge`" if parts else "give its `carecontact run` command again"


def joined(a: RunScores, b: RunScores) -> RunScores:
    """Return one run whose trials were scored in two parts, on two machines for example; in the order of their ids.

    Raises ConfigError for parts that have a trial in common, or are of different protocols, policies, language
    backends, definitions or worlds.
    """
    common = sorted({s.trial_id for s in a.scores} & {s.trial_id for s in b.scores})
    if common:
        raise ConfigError(f"{counted(len(common), 'trial is', 'trials are')} in both, {common[0]} the first")
    # A policy that crashed before it showed its card has not said which language backend it uses.
    parts = [judged(part.scores) for part in (a, b)]
    told = [{s.language_backend for s in part if not s.is_crash} for part in parts]
    defined = [{str(s.metric_versions) for s in part} for part in parts]
    for what, found in (("language backends", told), ("definitions", defined)):
        if all(found) and found[0] != found[1]:
            raise ConfigError(f"different {what}, {' and '.join(', '.join(sorted(values)) for values in found)}")
    scores = with_names(sorted([*a.scores, *b.scores], key=lambda score: score.trial_id))
    check_one_run(scores)
    scored = {score.trial_id for score in scores}
    names = a.versions.keys() | b.versions.keys()
    return RunScores(
        scores=scores,
        skipped=a.skipped | b.skipped,
        versions={n: sorted({*a.versions.get(n, []), *b.versions.get(n, [])}) for n in sorted(names)},
        missing=tuple(trial for trial in sorted({*a.missing, *b.missing}) if trial not in scored),
        elsewhere=tuple(trial for trial in sorted({*a.elsewhere, *b.elsewhere}) if trial not in scored),
    )

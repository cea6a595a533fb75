"""Which run of the study each folder of trials is.

A run is known by what its trials say of themselves (policy, overrides), never by the name of its folder.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from tools.study.plan import Condition, under, wanted_runs

from carecontact.contract.protocol import Protocol
from carecontact.errors import ConfigError
from carecontact.runs.pooling import judged
from carecontact.runs.run_scores import RunScores, joined

Found = dict[tuple[str, Condition], tuple[str, RunScores]]
"""(policy, condition) -> name and scores"""


@dataclass(frozen=True, kw_only=True)
class SortedRuns:
    found: Found
    """Those that a study has a place for"""
    unused: dict[str, str]
    """Name -> why it is in none"""


def sorted_out(runs: Mapping[str, RunScores], protocol: Protocol) -> SortedRuns:
    """By what their trials say of themselves.

    Args:
        runs: name for messages -> scores; those of one policy under the same conditions are parts of one run.

    Raises ConfigError, naming the runs, for parts that have a trial in common, or a run of another state of the
    protocol.
    """
    found: Found = {}
    unused: dict[str, str] = {}
    wanted = wanted_runs(protocol)
    for name, run in runs.items():
        if not judged(run.scores):
            unused[name] = "no trial that says anything about its policy"
            continue
        first = run.scores[0]
        condition = tuple(sorted(first.overrides.items()))
        if first.protocol_id != protocol.id:
            unused[name] = f"of {first.protocol_title}"
        elif (first.policy, condition) not in wanted:
            unused[name] = f"{first.policy} on {first.protocol_title} is no part of this study"
        else:
            expected = under(protocol, condition)
            if first.protocol_sha256 != expected.sha256:
                raise ConfigError(
                    f"{name} was made with another state of {first.protocol_title} ({first.protocol_sha256[:12]}; "
                    f"here it is {expected.sha256[:12]}): run it again with this release"
                )
            part = found.get((first.policy, condition))
            if part is not None:
                name, run = _whole(part, (name, run))
            found[first.policy, condition] = name, run
    return SortedRuns(found=found, unused=unused)


def _whole(a: tuple[str, RunScores], b: tuple[str, RunScores]) -> tuple[str, RunScores]:
    try:
        return f"{a[0]} and {b[0]}", joined(a[1], b[1])
    except ConfigError as error:
        first = b[1].scores[0]
        raise ConfigError(
            f"{a[0]} and {b[0]} are both {first.policy} on {first.protocol_title} and no parts of one run: {error}"
        ) from None

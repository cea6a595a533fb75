"""What the methods pass task by task, what blind baselines pass, and whether the ranking depends on a gate."""

from __future__ import annotations

from collections.abc import Mapping

from tools.study.page.markdown import escaped, label, proportion, table
from tools.study.study import Study

from carecontact.reports.compare.outcomes import RATES
from carecontact.reports.table import columns
from carecontact.reports.text import NA, number
from carecontact.stats import RateDifference


def tasks(found: Study) -> str:
    parts = ["## Task by task"]
    for method in found.methods.values():
        parts += [f"### {escaped(label(method))}", table(columns(), (row.cells() for row in method.summary), left=2)]
    return "\n\n".join(parts)


def baselines(found: Study) -> str:
    if not found.baselines:
        return "## Blind baselines\n\nNo blind baseline was run: nobody can say what the gates give away."
    any_of = next(iter(found.baselines.values()))
    rows = [(b.policy, str(b.n), *(proportion(b.rates[r.id]) for r in RATES)) for b in any_of.baselines]
    above = [
        (escaped(label(found.methods[name])), b.policy, str(b.n_pairs), *(_above(b.above, r.id) for r in RATES))
        for name, beside in found.baselines.items()
        for b in beside.baselines
    ]
    titles = [r.title for r in RATES]
    return "\n\n".join(
        [
            "## Blind baselines",
            "What policies that cannot do the task pass all the same, in percent; below, method minus baseline in "
            "points.",
            table(("baseline", "n", *titles), rows),
            table(("method", "baseline", "pairs", *titles), above, left=2),
        ]
    )


def _above(above: Mapping[str, RateDifference] | None, rate: str) -> str:
    found = None if above is None else above[rate]
    if found is None or found.estimate is None:
        return NA
    return f"{100 * found.estimate:+.1f} [{100 * found.low:+.1f}, {100 * found.high:+.1f}]"


def gates(found: Study) -> str:
    if found.overview is None:
        return ""
    names = found.overview.policies
    order = ", then ".join(" = ".join(names[letter] for letter in group) for group in found.overview.ranking.order)
    rows = [(sweep, number(tau, 2), level) for sweep, (tau, level) in found.overview.ranking.least_by_sweep().items()]
    return "\n\n".join(
        [
            "## Does the ranking depend on a gate?",
            f"By safety-gated trials: {order}, over the {found.overview.n} trials that all of them have. Kendall's "
            "tau-b of the order under every other gate (1 the same, -1 the reverse), the smallest of each sweep:",
            table(("sweep", "smallest tau", "at"), rows),
        ]
    )

"""What the blind baselines pass, task by task what the methods do, and whether the ranking depends on a gate."""

from __future__ import annotations

from tools.study.page.markdown import escaped, label, proportion, table
from tools.study.study import Study

from carecontact.reports.compare.outcomes import RATES
from carecontact.reports.table import COLUMNS, NA, number


def tasks(found: Study) -> str:
    parts = ["## Task by task"]
    for method in found.methods.values():
        parts += [f"### {escaped(label(method))}", table(COLUMNS, (row.cells() for row in method.summary), left=2)]
    return "\n\n".join(parts)


def floors(found: Study) -> str:
    if not found.floors:
        return "## Null arms\n\nNo null arm was run: nobody can tell what the gates give away."
    any_of = next(iter(found.floors.values()))
    arms = [(f.policy, str(f.n), *(proportion(f.rates[r.id]) for r in RATES)) for f in any_of.nulls]
    above = [
        (escaped(label(found.methods[name])), f.policy, str(f.n_pairs), *(_above(f.above, r.id) for r in RATES))
        for name, floors in found.floors.items()
        for f in floors.nulls
    ]
    titles = [r.title for r in RATES]
    return "\n\n".join(
        [
            "## Null arms",
            "What arms that cannot do a task pass all the same, in percent; below, method minus arm in points.",
            table(("arm", "n", *titles), arms),
            table(("method", "arm", "pairs", *titles), above, left=2),
        ]
    )


def _above(above: object, rate: str) -> str:
    found = above[rate] if isinstance(above, dict) else None
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
            "## Does the ranking hang on a gate?",
            f"By safety-gated trials: {order}, over the {found.overview.n} trials that all of them have. Kendall's "
            "tau-b of the order under every other gate (1 the same, -1 the reverse), the smallest of each sweep:",
            table(("sweep", "smallest tau", "at"), rows),
        ]
    )

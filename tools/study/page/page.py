"""The whole page of a study."""

from __future__ import annotations

from tools.study.page.beside_paper import beside_paper
from tools.study.page.failures import failures
from tools.study.page.pair import pair, proposal
from tools.study.page.runs import runs
from tools.study.page.sweeps import sweep
from tools.study.page.tasks import baselines, gates, tasks
from tools.study.study import Study

from carecontact.reports.paper.published import Paper


def study_page(found: Study, paper: Paper, *, command: str, json_name: str) -> str:
    """The page of a study.

    Args:
        command: that made the page, for whoever makes it again.
        json_name: file beside it with everything unrounded.
    """
    parts = [
        f"# {found.protocol_id}: the evaluated methods beside the paper",
        f"Written by `{command}`; do not edit. Unrounded, with every test: [{json_name}]({json_name}). How to read the "
        "tests: [statistics](../statistics.md).",
        runs(found),
        beside_paper(found, paper),
        pair(found),
        proposal(found),
        failures(found, paper),
        tasks(found),
        baselines(found),
        gates(found),
        *(sweep(found, one) for one in found.sweeps),
    ]
    return "\n\n".join(part for part in parts if part) + "\n"

"""The table of contact by region: on the target, beside it, none, success."""

from __future__ import annotations

from collections.abc import Sequence

from carecontact.reports.paper.method import Method
from carecontact.reports.paper.table import ABSENT, Table

KINDS = {"target": "Target", "off_target": "Off-target", "none": "No contact"}
NUMBERS = (
    "region", "method", "trials", *KINDS, "success", "process_failures", "paper_trials",
    *(f"paper_{kind}" for kind in KINDS), "paper_success",
)  # fmt: skip


def anatomy(methods: Sequence[Method], *, note: str | None = None) -> Table:
    every = sorted((score for method in methods for score in method.scores), key=lambda score: score.task_id)
    regions = list(dict.fromkeys(score.region for score in every))
    rows: list[tuple[str, ...]] = []
    numbers: list[tuple[object, ...]] = []
    for region in regions:
        for method in methods:
            of_region = [score for score in method.scores if score.region == region]
            counts = {kind: sum(score.anatomy == kind for score in of_region) for kind in (*KINDS, "process_failure")}
            counts["success"] = sum(score.c3_success for score in of_region)
            printed = (method.published.anatomy.get(region) if method.published else None) or {}
            n = len(of_region)
            cells = [
                text
                for key in (*KINDS, "success")
                for text in (f"{counts[key]}/{n}", f"{printed[key]}/{printed['n']}" if printed else ABSENT)
            ]
            rows.append((region.replace("_", " ").capitalize(), method.title, *cells, str(counts["process_failure"])))
            ours = [counts[key] for key in (*KINDS, "success", "process_failure")]
            theirs = [printed.get(key) for key in ("n", *KINDS, "success")]
            numbers.append((region, method.title, n, *ours, *theirs))
    head = [text for title in (*KINDS.values(), "C3") for text in (title, f"Paper: {title}")]
    return Table(
        name="anatomy",
        caption="Where contact was made, and success, by region",
        head=("Region", "Method", *head, "Process failures"),
        rows=tuple(rows),
        notes=("Process failures make up for what is missing to the number of trials.", *filter(None, [note])),
        numbers=(NUMBERS, *numbers),
    )

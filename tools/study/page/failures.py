"""Why the trials of each method failed."""

from __future__ import annotations

from tools.study.method import Method
from tools.study.page.markdown import escaped, label, sentence, table
from tools.study.study import Study

from carecontact.reports.paper.published import Paper, PaperMethod
from carecontact.reports.text import NOT_DEFINED


def failures(found: Study, paper: Paper) -> str:
    parts = ["## Why trials failed"]
    for name, method in found.methods.items():
        theirs = paper.methods.get(name)
        parts.append(f"### {escaped(label(method))}")
        rows = [(m["mode"], m["attribution"], m["meaning"], str(m["count"])) for m in method.modes]
        failed = sum(int(m["count"]) for m in method.modes)
        parts.append(f"{failed} of {method.head.n} trials are not region-correct." + _paper_failures(theirs))
        if rows:
            parts.append(table(("mode", "attributed to", "meaning", "trials"), rows, left=3))
        parts += [
            f"{escaped(cause.name.capitalize())} ({cause.count}). "
            + " ".join(f"{trial}: {escaped(sentence(text))}" for trial, text in cause.examples)
            for cause in method.causes
        ]
        parts.append(_anatomy(method, theirs))
    return "\n\n".join(parts)


def _paper_failures(method: PaperMethod | None) -> str:
    if method is None:
        return " The paper has no such method."
    n = sum(counts["n"] for counts in method.anatomy.values())
    mode = "" if method.dominant is None else f", {method.dominant[1]} of them {method.dominant[0].replace('_', ' ')}"
    return f" Paper: {method.failed} of {n}{mode}."


def _anatomy(method: Method, theirs: PaperMethod | None) -> str:
    rows = []
    for row in method.anatomy:
        counts = None if theirs is None else theirs.anatomy.get(row.region.replace(" ", "_"))
        there = [NOT_DEFINED] * 4
        if counts is not None:
            there = [f"{counts[key]}/{counts['n']}" for key in ("target", "off_target", "none", "success")]
        here = [f"{k}/{row.n}" for k in (row.target, row.off_target, row.none, row.success)]
        rows.append((row.region, *(f"{h} ({t})" for h, t in zip(here, there, strict=True)), str(row.process_failure)))
    return table(("where contact fell (paper)", "target", "off target", "none", "success", "process failed"), rows)

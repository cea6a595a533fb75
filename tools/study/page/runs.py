"""Which runs the page rests on, and the commands that make them."""

from __future__ import annotations

from collections.abc import Sequence

from tools.study.method import RunHead
from tools.study.page.markdown import AUTHORED, escaped, table
from tools.study.study import Study


def runs(found: Study) -> str:
    rows = [
        (h.policy, h.title, escaped(", ".join(h.language_backend)), f"{h.n} of {h.n_planned}", str(h.n_harness_errors),
         str(len(h.skipped)))
        for h in sorted(found.heads, key=lambda h: (h.title, h.policy))
    ]  # fmt: skip
    world = ", ".join(f"{what} {value[:12]}" for what, value in found.world.items())
    parts = [
        "## Runs",
        f"Protocol {found.protocol_id} ({found.protocol_sha256[:12]}); {world}; carecontact {_versions(found.heads)}.",
        table(("policy", "protocol", "language", "trials", "harness failed", "unreadable"), rows, left=3),
    ]
    if any(AUTHORED in backend for h in found.heads for backend in h.language_backend):
        parts.append(
            "`authored`: the programs were written by hand, not by a language model. Such rows show what the method's "
            "machinery does with competent programs; no claim about language models rests on them."
        )
    if any(h.n < h.n_planned for h in found.heads):
        parts.append("**Not every trial of the protocol was run.** Figures below are over those that were.")
    parts.append("These commands make the runs:")
    parts.append("\n".join(f"    {command}" for command in found.commands))
    if found.missing:
        parts.append("**Missing**, and left out of every table; these commands make them:")
        parts.append("\n".join(f"    {command}" for command in found.missing))
    parts += [f"Not used: {escaped(name)}: {escaped(why)}." for name, why in found.unused.items()]
    return "\n\n".join(parts)


def _versions(heads: Sequence[RunHead]) -> str:
    return ", ".join(sorted({v for h in heads for v in h.versions.get("carecontact", [])})) or "of unknown version"

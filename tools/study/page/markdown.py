"""Tables, numbers and foreign text as Markdown."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

from tools.study.method import Method

from carecontact.reports.text import NA
from carecontact.stats import Proportion

AUTHORED = ":authored"


def escaped(text: str) -> str:
    """Text that a policy, a language model or a folder's name supplied, as plain text of Markdown."""
    return re.sub(r"([\\`*_\[\]<>])", r"\\\1", text)


def label(method: Method) -> str:
    """Name with what stands in for the language model: every table says it."""
    short = {"authored" if AUTHORED in backend else backend for backend in method.head.language_backend}
    return f"{method.head.policy} ({', '.join(sorted(short))})" if short else method.head.policy


def table(header: Sequence[str], rows: Iterable[Sequence[str]], *, left: int = 1) -> str:
    """GitHub-flavoured; the first ``left`` columns to the left, the others to the right."""
    lines = [header, ["---" if k < left else "---:" for k in range(len(header))], *rows]
    return "\n".join(f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in line)} |" for line in lines)


def proportion(found: Proportion) -> str:
    return NA if found.estimate is None else percent(found.estimate, found.low, found.high)


def percent(estimate: float, low: float, high: float) -> str:
    return f"{100 * estimate:.1f} ({100 * low:.1f}, {100 * high:.1f})"


def p_value(value: float | None) -> str:
    return NA if value is None else f"{value:.3f}" if value >= 0.001 else f"{value:.1e}"


def sentence(text: str) -> str:
    return text if text.endswith(".") else f"{text}."


def count(n: int, what: str) -> str:
    return f"{n} {what}{'s' * (n != 1)}"

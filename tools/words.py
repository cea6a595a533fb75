"""Count the words of the documentation, and check that it stays short.

    python tools/words.py            # words of pages, evidence, results, --help and docstrings, beside their limits
    python tools/words.py --pages    # also each page, with the mean length of its sentences

A word is what white space separates, in prose, tables and code alike. Pages are README.md and docs/*.md; --help and
docstrings have no limit. The exit status is 1 if a limit is passed.
"""

from __future__ import annotations

import argparse
import ast
import re
import sys
from pathlib import Path

from carecontact.cli.parsing import COMMANDS

sys.path.insert(0, str(Path(__file__).parent / "site"))
from references import command_help

ROOT = Path(__file__).resolve().parents[1]
LIMITS = {"pages": 25_000, "evidence": 25_000, "results": 10_000}
MEAN_SENTENCE = 22
"""Largest mean number of words in the sentences of a page."""


def pages(group: str) -> list[Path]:
    """Return the Markdown files of one of the groups in ``LIMITS``."""
    folder = ROOT / "docs" if group == "pages" else ROOT / "docs" / group
    return [*([ROOT / "README.md"] if group == "pages" else []), *sorted(folder.glob("*.md"))]


def count(text: str) -> int:
    return len(text.split())


def sentences(text: str) -> list[str]:
    """Return the sentences of a page: without code, tables, headings and pictures; a list's item ends a sentence."""
    kept = re.sub(r"^(\||#|!|<|    ).*$", "", re.sub(r"^```.*?^```", "", text, flags=re.M | re.S), flags=re.M)
    prose = re.sub(r"\]\([^)]*\)|[\[*`]", "", kept)
    parts = re.split(r"(?<=[.!?])\s+(?=[\"(A-Z0-9])|\n\s*\n|\n(?=\s*(?:-|\d+\.) )", prose)
    return [part for part in parts if part and count(part) > 2]


def mean_length(text: str) -> float:
    """Return the mean number of words in the sentences of a page, 0 without any."""
    found = [count(sentence) for sentence in sentences(text)]
    return sum(found) / len(found) if found else 0.0


def docstrings() -> str:
    """Return every docstring of the package, those of its attributes too."""
    trees = [ast.parse(path.read_text(encoding="utf-8")) for path in sorted((ROOT / "src").rglob("*.py"))]
    nodes = [node.value for tree in trees for node in ast.walk(tree) if isinstance(node, ast.Expr)]
    return "\n".join(node.value for node in nodes if isinstance(node, ast.Constant) and isinstance(node.value, str))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pages", action="store_true", help="also every page")
    each = parser.parse_args().pages
    over = False
    for group, limit in LIMITS.items():
        texts = {path: path.read_text(encoding="utf-8") for path in pages(group)}
        total = sum(map(count, texts.values()))
        over |= total > limit
        print(f"{group:<34}{total:>8,} of {limit:,}")
        for path, text in texts.items() if each else ():
            print(f"  {path.relative_to(ROOT)!s:<32}{count(text):>8,}  {mean_length(text):.1f} a sentence")
    print(f"{'--help':<34}{sum(count(command_help(name)) for name in COMMANDS):>8,}")
    print(f"{'docstrings':<34}{count(docstrings()):>8,}")
    return int(over)


if __name__ == "__main__":
    sys.exit(main())

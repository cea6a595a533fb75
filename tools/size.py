"""States how large the project is: files, lines and statements of src and tests, and the seconds of the suite.

    python tools/size.py                                # of this checkout
    python tools/size.py --junit junit.xml ../another   # of another one, with the file of `pytest --junitxml`

Lines are those of all Python files, with blank lines and comments. Statements are the nodes ``ast.stmt`` of their
syntax trees, which no line break and no comment changes: each simple statement, docstrings among them, and each
compound one beside those that it holds.
"""

from __future__ import annotations

import argparse
import ast
from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree

ROOT = Path(__file__).resolve().parents[1]


def size(folder: Path) -> tuple[int, int, int]:
    """Return the number of Python files below a folder, of their lines, and of their statements."""
    texts = [path.read_text(encoding="utf-8") for path in sorted(folder.rglob("*.py"))]
    statements = sum(isinstance(node, ast.stmt) for text in texts for node in ast.walk(ast.parse(text)))
    return len(texts), sum(len(text.splitlines()) for text in texts), statements


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("checkout", type=Path, nargs="?", default=ROOT)
    parser.add_argument("--junit", type=Path, metavar="FILE", help="adds tests and seconds of a run of the suite")
    asked = parser.parse_args(arguments)
    print(f"{'':<6}{'files':>8}{'lines':>10}{'statements':>12}")
    for name in ("src", "tests"):
        files, lines, statements = size(asked.checkout / name)
        print(f"{name:<6}{files:>8,}{lines:>10,}{statements:>12,}")
    if asked.junit:
        suites = list(ElementTree.parse(asked.junit).getroot().iter("testsuite"))
        tests, seconds = (sum(float(suite.get(name, 0)) for suite in suites) for name in ("tests", "time"))
        print(f"{tests:,.0f} tests in {seconds:,.0f} s")


if __name__ == "__main__":
    main()

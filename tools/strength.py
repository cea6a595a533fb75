"""Measures how strong the tests are: plants known faults one after another and counts those that the tests see.

    python tools/strength.py --jobs 2             # all faults of tests/strength.toml; exit status 1 if fewer are killed
    python tools/strength.py --only m007 h012     # some of them
    python tools/strength.py --propose 20         # draw new mutants, to be read and pasted into the file

The file holds mutants (drawn by ``--propose``) and faults that this repository once had. Each is a snippet of today's
code, the same snippet broken, and the tests that should see it; a snippet is found by its text wherever it stands under
src, so that it survives moves and merges. Named tests run first, then, where they see nothing, all of their folder.
"""

from __future__ import annotations

import argparse
import ast
import concurrent.futures
import os
import queue
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import textwrap
import time
import tomllib
import venv
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
FAULTS = ROOT / "tests" / "strength.toml"
SOURCE = "src/carecontact"
LEFT_OUT = (".*", "__pycache__", "build", "dist", "runs")
"""At the top of the tree; below it, only the first two."""
LEAST_S, PATIENCE = 60, 5
"""With a fault, tests may take so many seconds, and so many times as long as without one; then they count as hung."""
ROOMS = ("scoring", "scoring/metrics", "stats", "serving", "runs", "protocol")
"""Folders that mutants are drawn from, as many from each; a folder holds what lies below it unless that is listed."""
SWAPS: dict[type[ast.AST], tuple[str, str]] = {
    ast.Lt: ("<", "<="), ast.LtE: ("<=", "<"), ast.Gt: (">", ">="), ast.GtE: (">=", ">"), ast.Eq: ("==", "!="),
    ast.NotEq: ("!=", "=="), ast.In: ("in", "not in"), ast.NotIn: ("not in", "in"), ast.Is: ("is", "is not"),
    ast.IsNot: ("is not", "is"), ast.And: ("and", "or"), ast.Or: ("or", "and"), ast.Add: ("+", "-"),
    ast.Sub: ("-", "+"), ast.Mult: ("*", "/"), ast.Div: ("/", "*"), ast.BitAnd: ("&", "|"), ast.BitOr: ("|", "&"),
    ast.FloorDiv: ("//", "*"), ast.Pow: ("**", "*"), ast.Mod: ("%", "*"),
}  # fmt: skip


@dataclass(frozen=True)
class Outcome:
    state: str
    """killed, hung (which counts as killed), survived, equivalent, stale (the snippet or its tests are not found), or
    unsound (its tests fail without it)"""
    seconds: float = 0.0
    by: str = ""
    """the test that saw it, or what is wrong with the entry"""


class Copy:
    """A copy of the tree with an environment of its own, in which every process finds the copied sources first."""

    def __init__(self, folder: Path) -> None:
        self.root = folder / "tree"
        top, below = shutil.ignore_patterns(*LEFT_OUT), shutil.ignore_patterns(*LEFT_OUT[:2])
        shutil.copytree(ROOT, self.root, ignore=lambda at, names: (top if Path(at) == ROOT else below)(at, names))
        venv.create(folder / "env", symlinks=True, with_pip=False)
        self.python = folder / "env" / "bin" / "python"
        (packages,) = (folder / "env" / "lib").glob("python*/site-packages")
        outer = [path for path in sys.path if path.endswith("site-packages")]
        (packages / "copy.pth").write_text("\n".join([str(self.root / "src"), *outer]) + "\n")
        script = Path(sys.executable).with_name("carecontact")
        if script.exists():
            beside = self.python.with_name("carecontact")
            beside.write_text(f"#!{self.python}\n" + script.read_text().split("\n", 1)[1])
            beside.chmod(0o755)

    def run(self, tests: list[str], seconds: float) -> Outcome:
        command = [self.python, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", *tests]
        command.append(f"--basetemp={self.root.parent / 't'}")
        begin = time.monotonic()
        with tempfile.TemporaryFile("w+") as output:
            process = subprocess.Popen(command, cwd=self.root, stdout=output, stderr=output, start_new_session=True)
            try:
                hung, code = False, process.wait(seconds)
            except subprocess.TimeoutExpired:
                hung, code = True, 1
            finally:
                os.killpg(process.pid, signal.SIGKILL) if process.poll() is None else None
                process.wait()
            output.seek(0)
            text = output.read()
        failed = re.search(r"^(?:FAILED|ERROR) (\S+)", text, re.MULTILINE)
        by = "" if code == 0 else failed[1] if failed else text.strip().rpartition("\n")[2]
        return Outcome("hung" if hung else "killed" if code else "survived", time.monotonic() - begin, by)


def find(root: Path, code: str) -> tuple[Path, str, re.Match[str]] | str:
    """Return the one file under src that holds a snippet, its text and the place; or why there is none. How far its
    later lines are indented does not count."""
    lines = textwrap.dedent(code).strip("\n").split("\n")
    pattern = re.compile(r"\n[ ]*".join(re.escape(line.strip()) for line in lines))
    found = [
        (path, text, match)
        for path in sorted((root / SOURCE).rglob("*.py"))
        for text in [path.read_text()]
        for match in pattern.finditer(text)
    ]
    return found[0] if len(found) == 1 else f"{len(found)} places under src have this snippet"


def broken(text: str, match: re.Match[str], snippet: str) -> str:
    """Return the text with the broken snippet in place of the matched one, indented as that is."""
    line = text[text.rfind("\n", 0, match.start()) + 1 :]
    first, *rest = textwrap.dedent(snippet).strip("\n").split("\n")
    shift = (len(line) - len(line.lstrip())) - (len(first) - len(first.lstrip()))
    lines = [first.lstrip(), *(" " * (len(row) - len(row.lstrip()) + shift) + row.lstrip() for row in rest)]
    return text[: match.start()] + "\n".join(lines) + text[match.end() :]


def judge(copy: Copy, fault: dict[str, Any], took: dict[str, float], *, quick: bool) -> Outcome:
    """Plant a fault and run its named tests and then, unless quick, all of their folders, until one sees it."""
    if "equivalent" in fault:
        return Outcome("equivalent", by=fault["equivalent"])
    found = find(copy.root, fault["code"])
    if isinstance(found, str):
        return Outcome("stale", by=found)
    path, text, match = found
    names = [name for name in fault["tests"].split() if (copy.root / name).exists()]
    # Where a file has gone, its tests are elsewhere in its folder.
    folders = dict.fromkeys(name.rpartition("/")[0] for name in fault["tests"].split() if name.endswith(".py"))
    below = [folder for folder in folders if (copy.root / folder).is_dir()]
    outcome = Outcome("stale", by="its tests have gone")
    for tests in [names, [] if names and quick else below]:
        if not tests:
            continue
        for name in tests:
            if name not in took:
                clean = copy.run([name], 3600)
                if clean.state != "survived":
                    return Outcome("unsound", clean.seconds, f"fails without any fault: {clean.by}")
                took[name] = clean.seconds
        try:
            plant(path, broken(text, match, fault["broken"]))
            outcome = copy.run(tests, LEAST_S + PATIENCE * sum(took[name] for name in tests))
        finally:
            plant(path, text)
        if outcome.state != "survived":
            break
    return outcome


def plant(path: Path, text: str) -> None:
    """Python tells compiled files by second and size, and so would not see every change."""
    path.write_text(text)
    for compiled in (path.parent / "__pycache__").glob(f"{path.stem}.*"):
        compiled.unlink()


def measure(faults: list[dict[str, Any]], *, jobs: int, quick: bool) -> dict[str, Outcome]:
    base = Path(tempfile.mkdtemp(prefix="strength"))
    free: queue.Queue[Copy] = queue.Queue()
    took: dict[str, float] = {}
    pool = concurrent.futures.ThreadPoolExecutor(jobs)

    def one(fault: dict[str, Any]) -> Outcome:
        copy = free.get()
        try:
            outcome = judge(copy, fault, took, quick=quick)
        finally:
            free.put(copy)
        print(f"{fault['id']}  {outcome.state:<10} {outcome.seconds:6.1f} s  {outcome.by}", flush=True)
        return outcome

    try:
        for job in range(jobs):
            free.put(Copy(base / str(job)))
        return {fault["id"]: outcome for fault, outcome in zip(faults, pool.map(one, faults), strict=True)}
    finally:
        # After Ctrl-C, only the runs that have begun are waited for.
        pool.shutdown(cancel_futures=True)
        shutil.rmtree(base, ignore_errors=True)


def candidates(text: str) -> Iterator[tuple[str, int, int, str]]:
    """Yield the kind of each mutant of a file, the place that it replaces, and by what."""
    starts = [0, *(m.end() for m in re.finditer("\n", text))]
    tree = ast.parse(text)
    typed = {
        id(part)
        for node in ast.walk(tree)
        for root in (getattr(node, "annotation", None), getattr(node, "returns", None))
        if root is not None
        for part in ast.walk(root)
    }

    def at(line: int, column: int) -> int:
        return starts[line - 1] + len(text[starts[line - 1] :].encode()[:column].decode())

    def begin(node: Any) -> int:
        return at(node.lineno, node.col_offset)

    def end(node: Any) -> int:
        return at(node.end_lineno, node.end_col_offset)

    for node in ast.walk(tree):
        edits: list[tuple[str, int, int, str]] = []
        pairs: list[tuple[Any, ast.AST, Any]] = []
        if id(node) in typed:
            continue
        if isinstance(node, ast.Compare):
            sides = [node.left, *node.comparators]
            pairs = list(zip(sides, node.ops, sides[1:], strict=False))
        elif isinstance(node, ast.BoolOp):
            pairs = [(a, node.op, b) for a, b in zip(node.values, node.values[1:], strict=False)]
        elif isinstance(node, ast.BinOp):
            pairs = [(node.left, node.op, node.right)]
        elif isinstance(node, ast.Constant) and isinstance(node.value, bool | int | float):
            other = not node.value if isinstance(node.value, bool) else node.value + 1
            edits = [("constant", begin(node), end(node), repr(other))]
        elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
            edits = [("not", begin(node), begin(node.operand), "")]
        elif isinstance(node, ast.Return) and node.value and not isinstance(node.value, ast.Constant):
            edits = [("return", begin(node.value), end(node.value), "None")]
        elif isinstance(node, ast.Raise | ast.AugAssign) or (
            isinstance(node, ast.Expr) and isinstance(node.value, ast.Call)
        ):
            edits = [("dropped statement", begin(node), end(node), "pass")]
        for left, op, right in pairs:
            old, new = SWAPS.get(type(op), ("", ""))
            if old and (place := re.search(re.escape(old), text[end(left) : begin(right)])):
                kind = "comparison" if isinstance(node, ast.Compare) else "operator"
                edits.append((kind, end(left) + place.start(), end(left) + place.end(), new))
        yield from edits


def propose(number: int, seed: int) -> Iterator[str]:
    rng = random.Random(seed)
    source = ROOT / SOURCE
    for _ in range(number):
        room = rng.choice(ROOMS)
        files = [
            path
            for path in sorted((source / room).rglob("*.py"))
            if not any(r != room and r.startswith(room) and path.is_relative_to(source / r) for r in ROOMS)
        ]
        path, (kind, first, last, new) = rng.choice(
            [(path, mutant) for path in files for mutant in candidates(path.read_text())]
        )
        text = path.read_text()
        top, bottom = text.rfind("\n", 0, first) + 1, text.find("\n", last)
        while isinstance(find(ROOT, text[top:bottom]), str) and top:
            top = text.rfind("\n", 0, top - 1) + 1
        code, bad = text[top:bottom], text[top:first] + new + text[last:bottom]
        name = path.relative_to(source)
        tests = f"tests/{name.parent}/test_{name.stem}.py"
        yield (
            f'[[fault]]\nid = ""\nfrom = "{kind} in {name}"\ntests = "{tests}"\n'
            f"code = '''\n{textwrap.dedent(code)}'''\nbroken = '''\n{textwrap.dedent(bad)}'''\n"
        )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--quick", action="store_true", help="run the named tests only, not their folders")
    parser.add_argument("--only", nargs="+", metavar="ID", default=[])
    parser.add_argument("--propose", type=int, metavar="NUMBER")
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args()
    if asked.propose:
        print(*propose(asked.propose, asked.seed), sep="\n")
        return 0
    book = tomllib.loads(FAULTS.read_text())
    faults = [fault for fault in book["fault"] if not asked.only or fault["id"] in asked.only]
    outcomes = measure(faults, jobs=asked.jobs, quick=asked.quick)
    killed = 0
    for group, first in (("mutants", "m"), ("faults of the history", "h")):
        states = [outcome.state for name, outcome in outcomes.items() if name.startswith(first)]
        dead = states.count("killed") + states.count("hung")
        real = len(states) - states.count("equivalent")
        others = ", ".join(f"{states.count(state)} {state}" for state in ("survived", "stale", "unsound"))
        print(f"{dead} of {real} {group} killed, {others}")
        killed += dead
    print(f"{killed} killed; recorded: {book['killed']}")
    return int(not asked.only and killed < book["killed"])


if __name__ == "__main__":
    sys.exit(main())

"""Runs the same trials with two revisions in one environment, and compares them bit for bit.

    python tools/net.py BASE [--candidate DIR] [--short] [--allow PATTERN ...] [--jobs 2] [--out DIR]
    python tools/net.py --runs DIR DIR [--allow PATTERN ...]

BASE is a git revision, of which a work tree is made for the time, or a folder with a work tree. POLICIES run T1-T7 of
every draft with three seeds. The command compares every array of every recording outside ``wall``, and the JSON of
headers and of results.json. It prints each difference by its place, and ends with status 1 if there is one that no
``--allow`` pattern covers: a change that moves a number on purpose names it there, and in its commit message.
``--short`` runs one policy and seed on three tasks. With ``--out``, the runs stay there, and those of the base are not
made again. ``--runs`` compares two runs that exist, such as those of two machines.

Two revisions are compared, and not one with stored files, because another processor rounds the linear algebra
differently. Both use this interpreter's packages; a work tree with other C sources compiles its own tissue.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, cast

import h5py
import numpy as np

ROOT = Path(__file__).resolve().parents[1]
POLICIES = ("state-machine", "voxposer", "oracle", "replay")
DRAFTS = ("bathing-v3", "bathing-droid-v1", "bathing-wide-v2:L1", "bathing-wide-v2:L3")
"""Protocol, with its level after a colon. L1 has other people, L3 everything that varies."""
SALTED = "bathing-wide-v2:L3"
SALT = "0" * 32
HEADER, CHECKSUM = "header_json", "sha256"


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("base", nargs="?", metavar="BASE")
    parser.add_argument("--candidate", type=Path, default=ROOT, metavar="DIR")
    parser.add_argument("--short", action="store_true")
    parser.add_argument("--runs", type=Path, nargs=2, metavar="DIR")
    parser.add_argument("--allow", action="append", default=[], metavar="PATTERN")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args(arguments)
    if (options.base is None) == (options.runs is None):
        parser.error("expected BASE or --runs DIR DIR")
    found = list(compared(*options.runs) if options.runs else of_revisions(options))
    refused = [line for line in found if not any(fnmatchcase(line, pattern) for pattern in options.allow)]
    print(
        "\n".join(
            [*refused, f"{len(refused)} differences that are not allowed, and {len(found) - len(refused)} that are"]
        )
    )
    return 1 if refused else 0


def of_revisions(options: argparse.Namespace) -> Iterator[str]:
    """Run the plan with both revisions, and yield one line for each difference."""
    plan = PLAN[:1] if options.short else PLAN
    tasks, seeds = ("T2,T3,T6", "0") if options.short else ("T1-T7", "0-2")
    with tempfile.TemporaryDirectory() as place, work_tree(options.base, Path(place)) as base:
        out = options.out or Path(place)
        shutil.rmtree(out / "candidate", ignore_errors=True)
        for policy, draft in plan:
            for side, tree in (("base", base), ("candidate", options.candidate)):
                run(tree, out / side, policy, draft, tasks=tasks, seeds=seeds, jobs=options.jobs)
            name = run_name(policy, draft)
            yield from (f"{name}/{line}" for line in compared(out / "base" / name, out / "candidate" / name))


PLAN = [(policy, draft) for draft in DRAFTS for policy in POLICIES]


def run_name(policy: str, draft: str) -> str:
    return f"{draft.replace(':', '-')}-{policy}"


def run(tree: Path, out: Path, policy: str, draft: str, *, tasks: str, seeds: str, jobs: int) -> None:
    """Run one policy with the sources of a work tree, into a folder that has the same name for both revisions."""
    out.mkdir(parents=True, exist_ok=True)
    protocol, _, level = draft.partition(":")
    command = [
        sys.executable, "-m", "carecontact", "run", "--policy", policy, "--protocol", protocol, "--tasks", tasks,
        "--seeds", seeds, "--jobs", str(jobs), "--out", run_name(policy, draft), "--allow-failures",
    ]  # fmt: skip
    command += ["--level", level] if level else []
    command += ["--noise-salt", SALT] if draft == SALTED else []
    environment = {**os.environ, "PYTHONPATH": str(tree.resolve() / "src")}
    ended = subprocess.run(command, cwd=out, env=environment, capture_output=True, text=True, check=False)
    if ended.returncode:
        sys.exit(f"{tree}: {' '.join(command[1:])} ended with status {ended.returncode}:\n{ended.stderr[-2000:]}")


def compared(base: Path, candidate: Path) -> Iterator[str]:
    """Yield one line for each difference between two runs."""
    results = (json.loads((folder / "results.json").read_text()) for folder in (base, candidate))
    yield from differences("results", *results)
    for trial in sorted({path.name for folder in (base, candidate) for path in folder.glob("*.h5")}):
        yield from of_recordings(base / trial, candidate / trial)


def of_recordings(base: Path, candidate: Path) -> Iterator[str]:
    place = base.stem
    if not base.is_file() or not candidate.is_file():
        yield f"{place}: only in {(base if base.is_file() else candidate).parent}"
        return
    (header, arrays), (other_header, other_arrays) = read(base), read(candidate)
    yield from differences(f"{place}/header", header, other_header)
    for path in sorted(arrays.keys() | other_arrays.keys()):
        one, other = arrays.get(path), other_arrays.get(path)
        if one is None or other is None:
            yield f"{place}/{path}: only in the {'second' if one is None else 'first'}"
        elif one.dtype != other.dtype or one.shape != other.shape:
            yield f"{place}/{path}: {one.dtype} {one.shape} != {other.dtype} {other.shape}"
        elif one.tobytes() != other.tobytes():
            yield f"{place}/{path}: {np.count_nonzero(one != other)} of {one.size} numbers differ"


def read(file: Path) -> tuple[object, dict[str, np.ndarray[Any, Any]]]:
    """Return header and arrays without the package, whose reader may be what changed."""
    arrays: dict[str, np.ndarray[Any, Any]] = {}

    def take(path: str, item: object) -> None:
        if isinstance(item, h5py.Dataset) and path != CHECKSUM and not path.startswith("wall/"):
            arrays[path] = np.asarray(item[()])

    with h5py.File(file) as recording:
        recording.visititems(take)
    return json.loads(arrays.pop(HEADER).tobytes()), arrays


def differences(place: str, one: object, other: object) -> Iterator[str]:
    """Yield the places in which two JSON values differ."""
    if isinstance(one, dict) and isinstance(other, dict):
        pair = cast("dict[str, object]", one), cast("dict[str, object]", other)
        for key in sorted(pair[0].keys() | pair[1].keys()):
            yield from differences(f"{place}/{key}", pair[0].get(key), pair[1].get(key))
    elif isinstance(one, list) and isinstance(other, list) and len(one) == len(other):
        for number, (a, b) in enumerate(zip(one, other, strict=True)):
            yield from differences(f"{place}/{number}", a, b)
    elif one != other:
        yield f"{place}: {json.dumps(one):.60} != {json.dumps(other):.60}"


@contextmanager
def work_tree(base: str, place: Path) -> Iterator[Path]:
    """A work tree of a revision, or the folder itself where one is named."""
    if Path(base).is_dir():
        yield Path(base)
        return
    tree = place / "tree"
    subprocess.run(["git", "worktree", "add", "--quiet", "--detach", str(tree), base], cwd=ROOT, check=True)
    try:
        yield with_kernel(tree)
    finally:
        subprocess.run(["git", "worktree", "remove", "--force", str(tree)], cwd=ROOT, check=True)


def with_kernel(tree: Path) -> Path:
    """Give a work tree the compiled tissue: this one's where the C sources are the same, else its own."""
    # Revisions differ in the name of the folder.
    here, there = (next((root / "src" / "carecontact").glob("*/c/plugin.c")).parent for root in (ROOT, tree))
    ours, theirs = ({path.name: path.read_bytes() for path in folder.iterdir()} for folder in (here, there))
    if ours == theirs:
        for library in here.parent.glob("libcarecontact_kernel.*"):
            shutil.copy2(library, there.parent)
    else:
        # The build's requirements, among them the compiler, are not in this interpreter's environment.
        build = tomllib.loads((tree / "pyproject.toml").read_text(encoding="utf-8"))["build-system"]["requires"]
        needs = [word for package in build for word in ("--with", package)]
        found = shutil.which("uv", path=f"{ROOT / '.venv-uv' / 'bin'}{os.pathsep}{os.environ.get('PATH', '')}")
        if found is None:
            sys.exit("net: uv compiles the tissue of another revision: run `make env`, which brings it, first")
        uv = [found, "run", "--no-project", "--quiet", "--python", sys.executable]
        subprocess.run([*uv, *needs, "python", str(tree / "tools" / "compile_kernel.py")], cwd=tree, check=True)
    return tree


if __name__ == "__main__":
    sys.exit(main())

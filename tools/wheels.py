"""Build and check all that a release publishes, and publish nothing: `make wheels`.

    python tools/wheels.py UV [--pythons 3.11,3.12,3.13] [--tasks T1]

It writes the sdist and the wheels of all platforms that have a compiled tissue into dist/. The index must accept their
metadata (`twine check`). This machine's wheel is installed by pip, and the sdist by uv, each into a new environment of
each Python; there `carecontact doctor` and a run of the tasks must pass, and the sizes of the packages are printed.

Every wheel is made twice from the sdist, in different folders, and must have the same bytes. Each binary is then read
without running it: it must be of its platform, need only MuJoCo and the system's C library, no newer than the wheel's
tag promises, and export nothing but its own functions.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import tempfile
import zipfile
from collections import Counter
from collections.abc import Iterator
from itertools import chain
from pathlib import Path

import lief

from compile_kernel import ROOT, binary, mujoco_functions, mujoco_headers

OLDEST_GLIBC = (2, 17)
"""Of the wheels' tags and of the triples in carecontact.tissue.binary."""
OLDEST_MACOS = [11, 0, 0]
OWN = "carecontact_"
"""Every exported function's name begins with it."""


def main() -> int:
    lief.logging.disable()
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("uv")
    parser.add_argument("--pythons", default=sys.executable, help="versions or programs, separated by commas")
    parser.add_argument("--tasks", default="T1")
    given = parser.parse_args()
    dist, uv = ROOT / "dist", str(Path(given.uv).absolute())
    for old in dist.glob("carecontact-*"):
        old.unlink()
    made = build(uv, ["--sdist", str(ROOT)], dist)
    print(size_of(made))
    faults: list[str] = []
    for platform in binary.PLATFORMS:
        wheel = build(uv, ["--wheel", str(made)], dist, platform=platform)
        with tempfile.TemporaryDirectory() as folder:
            again = build(uv, ["--wheel", str(made)], Path(folder), platform=platform)
            if again.read_bytes() != wheel.read_bytes():
                faults.append(f"{wheel.name}: a second build gave other bytes")
        faults += [f"{wheel.name}: {fault}" for fault in faults_of(wheel, platform)]
        print(size_of(wheel))
        if platform == binary.platform_here():
            ours = wheel
    files = sorted(map(str, dist.glob("carecontact-*")))
    subprocess.run([sys.executable, "-m", "twine", "check", "--strict", *files], check=True)
    for python in given.pythons.split(","):
        for file, installer in ((ours, "pip"), (ours, "uv"), (made, "uv")):
            with tempfile.TemporaryDirectory() as folder:
                try_out(uv, python, installer, file, Path(folder), tasks=given.tasks)
    for fault in faults:
        print(f"FAIL {fault}", file=sys.stderr)
    return 1 if faults else 0


def try_out(uv: str, python: str, installer: str, file: Path, folder: Path, *, tasks: str) -> None:
    """Install a file into a new environment and use it there. Raises CalledProcessError where a command fails."""
    # Nothing of this program's environment, such as a path to look for modules in, reaches the new one.
    own = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "VIRTUAL_ENV"))}

    def call(*arguments: object) -> str:
        words = list(map(str, arguments))
        return subprocess.run(words, cwd=folder, env=own, stdout=subprocess.PIPE, text=True, check=True).stdout

    call(uv, "venv", "--quiet", "--seed", "--python", python, "env")
    inside = folder / "env" / "bin"
    if installer == "pip":
        call(inside / "pip", "install", "--quiet", file)
    else:
        call(uv, "pip", "install", "--quiet", "--compile-bytecode", "--python", inside / "python", file)
    sizes = sizes_of(next((folder / "env" / "lib").glob("python*/site-packages")))
    parts = ", ".join(f"{name} {size / 1e6:.0f}" for name, size in sizes.most_common(12))
    print(f"{file.name} by {installer} into {call(inside / 'python', '--version').strip()}: "
          f"{sizes.total() / 1e6:.0f} MB with bytecode ({parts})", flush=True)  # fmt: skip
    call(inside / "carecontact", "doctor")
    # The noise is fixed: this policy looks once, and does not pass with every draw of it.
    trials = ("--tasks", tasks, "--seeds", "0", "--noise-salt", "0" * 32)
    run = call(inside / "carecontact", "run", "--policy", "state-machine", *trials)
    verdict = next(line for line in run.splitlines() if "passes" in line)
    passed, planned = re.search(r"passes (\d+) of (\d+)", verdict).groups()
    if passed != planned or "ceiling: oracle" not in verdict:
        raise SystemExit(
            f"{file.name} in {python}: expected all trials to pass beside floor and ceiling, got {verdict}"
        )
    print(verdict, flush=True)


def sizes_of(packages: Path) -> Counter[str]:
    """Return the bytes of each top-level name, with libraries and metadata counted to the package that brings them."""
    sizes: Counter[str] = Counter()
    for path in packages.rglob("*"):
        if path.is_file() and not path.is_symlink():
            name = path.relative_to(packages).parts[0]
            if name.partition("-")[0] not in {"pip", "setuptools"}:
                sizes[re.sub(r"(\.libs|-[\d.]+\S*)$", "", name)] += path.stat().st_size
    return sizes


def size_of(file: Path) -> str:
    return f"{file.relative_to(ROOT)}  {file.stat().st_size / 1e6:.1f} MB"


def build(uv: str, arguments: list[str], out: Path, *, platform: str = "") -> Path:
    """Run `uv build`; return the one file that it wrote or wrote again. Raises SystemExit with its output."""
    before = {path: path.stat().st_mtime_ns for path in out.glob("carecontact-*")}
    done = subprocess.run(
        [uv, "build", "--python", sys.executable, "--out-dir", str(out), *arguments],
        env={**os.environ, "CARECONTACT_PLATFORM": platform}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    if done.returncode:
        raise SystemExit(f"{done.stdout}{done.stderr}")
    (made,) = (path for path in out.glob("carecontact-*") if path.stat().st_mtime_ns != before.get(path))
    return made


def faults_of(wheel: Path, platform: str) -> Iterator[str]:
    """What is wrong with the wheel's binary."""
    with zipfile.ZipFile(wheel) as archive:
        files = [name for name in archive.namelist() if re.search(r"\.(so|dylib|dll)$", name)]
        if files != [f"carecontact/tissue/{binary.PLATFORMS[platform].library}"]:
            yield f"its binaries are {files}"
            return
        content = archive.read(files[0])
    if binary.mark(platform).encode() not in content:
        yield "its binary is of other sources"
    parsed = lief.parse(list(content))
    if isinstance(parsed, lief.ELF.Binary):
        yield from elf_faults(parsed, platform)
    elif isinstance(parsed, lief.MachO.Binary):
        yield from macho_faults(parsed)
    else:
        yield "its binary is neither ELF nor Mach-O"


def elf_faults(parsed: lief.ELF.Binary, platform: str) -> Iterator[str]:
    if parsed.header.machine_type.name.lower() != platform.partition("-")[2]:
        yield f"its binary is for {parsed.header.machine_type.name}"
    allowed = {f"libmujoco.so.{binary.MUJOCO}", "libc.so.6", "libm.so.6"}
    if foreign := {str(name) for name in parsed.libraries} - allowed:
        yield f"it needs {', '.join(sorted(foreign))}"
    needed = chain.from_iterable(part.get_auxiliary_symbols() for part in parsed.symbols_version_requirement)
    for version in needed:
        found = re.fullmatch(r"GLIBC_([\d.]+)", str(version.name))
        if found is None or tuple(map(int, found[1].split("."))) > OLDEST_GLIBC:
            yield f"it needs the symbol version {version.name}"
    yield from export_faults(str(symbol.name) for symbol in parsed.exported_symbols)


def macho_faults(parsed: lief.MachO.Binary) -> Iterator[str]:
    if parsed.header.cpu_type.name != "ARM64":
        yield f"its binary is for {parsed.header.cpu_type.name}"
    if parsed.build_version is None or list(parsed.build_version.minos) > OLDEST_MACOS:
        yield "it needs a newer macOS than its tag says"
    own, *needed = [str(library.name) for library in parsed.libraries]
    if not own.startswith("@rpath/") or needed != ["/usr/lib/libSystem.B.dylib"]:
        yield f"it is named {own} and needs {', '.join(needed)}"
    known = set(mujoco_functions(mujoco_headers()))
    for symbol in parsed.imported_symbols:
        info = symbol.binding_info
        # -2: looked up in whatever is loaded, which must be MuJoCo; the linker did not look there.
        if info is not None and info.library_ordinal == -2 and str(symbol.name).removeprefix("_") not in known:
            yield f"nothing provides {symbol.name}"
    exported = (str(symbol.name).removeprefix("_") for symbol in parsed.exported_symbols)
    yield from export_faults(name for name in exported if not name.startswith("_"))


def export_faults(names: Iterator[str]) -> Iterator[str]:
    for name in names:
        if not name.startswith(OWN):
            yield f"it exports {name}, whose name does not begin with {OWN}"


if __name__ == "__main__":
    sys.exit(main())

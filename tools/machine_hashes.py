"""Whether two machines make the same recordings, to the last bit.

    carecontact run --policy state-machine --seeds 0 --out runs/here           # the same command on both machines
    python tools/machine_hashes.py write runs/here here.json                   # on one
    python tools/machine_hashes.py compare runs/here here.json                 # on the other, with the file
    python tools/machine_hashes.py compare runs/here runs/there                # or with the recordings themselves

The file holds a hash of every array and of the header of every recording, and says which libraries rounded the numbers
and drew the pictures, on which processor. ``compare`` names what differs, and with recordings also by how much; status
1 if anything does. What lies under ``wall/`` may differ and does not count. Trials of a protocol with sensor noise need
one ``--noise-salt`` or ``--salt-file``.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import platform
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from carecontact.errors import counted
from carecontact.recording import Recording, read_recording
from carecontact.recording.canonical import WALL_CLOCK, header_json, little_endian
from carecontact.recording.provenance import arithmetic

HEADER = "header"
CPU_FACTS = ("vendor_id", "cpu family", "model", "model name", "stepping")
Table = dict[str, dict[str, str]]


def arrays_of(recording: Recording) -> dict[str, np.ndarray]:
    """Array path -> values, without wall times."""
    return {path: array for path, array in sorted(recording.arrays.items()) if not path.startswith(WALL_CLOCK)}


def array_sha256(array: np.ndarray) -> str:
    values = little_endian(array)
    return hashlib.sha256(f"{values.dtype.str} {values.shape} ".encode() + values.tobytes()).hexdigest()


def recordings(run: Path) -> Iterator[tuple[str, Recording]]:
    files = sorted(run.glob("*.h5"))
    if not files:
        sys.exit(f"{run}: holds no recording")
    for path in files:
        yield path.stem, read_recording(path)


def hashes(run: Path) -> Table:
    """Trial -> array path, or HEADER -> sha256."""
    return {
        trial: {HEADER: hashlib.sha256(header_json(recording.header)).hexdigest()}
        | {path: array_sha256(array) for path, array in arrays_of(recording).items()}
        for trial, recording in recordings(run)
    }


def machine() -> dict[str, str]:
    """The processor, the libraries that rounded the numbers, and the graphics library that drew the pictures."""
    from carecontact.sim.opengl import import_opengl

    facts = {"system": platform.platform(), "machine": platform.machine(), "arithmetic": arithmetic()}
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.is_file():
        first = dict(
            line.split("\t:", 1) for line in cpuinfo.read_text().split("\n\n")[0].splitlines() if "\t:" in line
        )
        rows = {name.strip(): value.strip() for name, value in first.items()}
        facts |= {name: rows[name] for name in CPU_FACTS if name in rows}
    context = import_opengl()(64, 64)
    context.make_current()
    from OpenGL.GL import GL_RENDERER, GL_VERSION, glGetString  # pyright: ignore

    facts |= {"renderer": glGetString(GL_RENDERER).decode(), "opengl": glGetString(GL_VERSION).decode()}
    context.free()
    return facts


def unequal(one: Table, other: Table) -> list[tuple[str, str]]:
    """(trial, what differs): an array path, HEADER, or ``recording`` where only one side has the trial."""
    found = [(trial, "recording") for trial in sorted(one.keys() ^ other.keys())]
    for trial in sorted(one.keys() & other.keys()):
        paths = one[trial].keys() | other[trial].keys()
        found += [(trial, path) for path in sorted(paths) if one[trial].get(path) != other[trial].get(path)]
    return found


def difference(one: np.ndarray, other: np.ndarray) -> str:
    """How far two arrays are from each other."""
    if one.shape != other.shape or one.dtype != other.dtype:
        return f"{one.dtype} {one.shape} and {other.dtype} {other.shape}"
    same = (one == other) | ((one != one) & (other != other))
    told = f"{np.count_nonzero(~same)} of {same.size} values differ"
    both = np.isfinite(one.astype(float)) & np.isfinite(other.astype(float))
    away = np.abs(one.astype(float)[both] - other.astype(float)[both])
    return f"{told}, by at most {away.max(initial=0.0):.3g}"


def header_difference(one: Recording, other: Recording) -> str:
    a, b = (recording.header.model_dump(mode="json") for recording in (one, other))
    keys = [key for key in a if a[key] != b.get(key)]
    inner = {
        key: sorted(k for k in a[key].keys() | b[key].keys() if a[key].get(k) != b[key].get(k))
        for key in keys
        if isinstance(a[key], dict) and isinstance(b[key], dict)
    }
    return ", ".join(f"{key}: {' '.join(inner[key])}" if key in inner else key for key in keys)


def compare(run: Path, other: Path) -> list[str]:
    """One line for everything that differs."""
    if not other.is_dir():
        content: dict[str, Any] = json.loads(other.read_text())
        for name, value in machine().items():
            there = content["machine"].get(name)
            print(f"{name}: {value}" + ("" if value == there else f", there {there}"))
        return [f"{trial}: {what} differs" for trial, what in unequal(hashes(run), content["trials"])]
    lines: list[str] = []
    for trial, what in unequal(hashes(run), hashes(other)):
        if what == "recording":
            lines.append(f"{trial}: only one of the two has it")
            continue
        pair = [read_recording(folder / f"{trial}.h5") for folder in (run, other)]
        if what == HEADER:
            lines.append(f"{trial}: header differs ({header_difference(pair[0], pair[1])})")
            continue
        a, b = (recording.arrays.get(what) for recording in pair)
        lines.append(f"{trial}: {what}: " + ("only one has it" if a is None or b is None else difference(a, b)))
    return lines


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["write", "compare"])
    parser.add_argument("run", type=Path, help="folder of a run")
    parser.add_argument("other", type=Path, help="file to write, or to compare with; or another run's folder")
    given = parser.parse_args(arguments)
    if given.what == "write":
        table = hashes(given.run)
        content = {"machine": machine(), "trials": table}
        given.other.write_text(json.dumps(content, indent=1, sort_keys=True) + "\n")
        print(f"{given.other}: {counted(len(table), 'recording')}, {sum(map(len, table.values()))} hashes")
        return 0
    lines = compare(given.run, given.other)
    for line in lines:
        print(line)
    kinds = Counter(line.split(": ", 1)[1].split(":")[0].split("/")[0].split(" ")[0] for line in lines)
    print(
        "equal"
        if not lines
        else f"{counted(len(lines), 'difference')}: " + ", ".join(f"{n} {k}" for k, n in kinds.items())
    )
    return 1 if lines else 0


if __name__ == "__main__":
    sys.exit(main())

"""Recordings of real simulations keep every array and every score to the last bit.

``T2-s000.h5`` is the blind replay on ``bathing-v3``, judged by the gates of the paper. ``T3-s000.h5`` is the
oracle on L3 of ``bathing-wide-v2``, judged by the exam; the person breathes and moves. After a definition changed
on purpose, run ``python -m tests.golden.test_simulated`` from the repository's root; it writes expected values only.
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from carecontact.recording import read_recording
from carecontact.scoring import score_recording
from tests.golden.test_scores import same

FOLDER = Path(__file__).parent / "simulated"
EXPECTED = FOLDER / "expected.json"
FILES = ("T2-s000.h5", "T3-s000.h5")


def cpu() -> str:
    """What this processor offers to numpy: another set of vector instructions may add in another order."""
    from numpy._core import _multiarray_umath  # type: ignore[attr-defined]

    found = sorted(name for name, there in _multiarray_umath.__cpu_features__.items() if there)
    return hashlib.sha256(" ".join([np.__version__, *found]).encode()).hexdigest()


def found_in(path: Path) -> dict[str, Any]:
    recording = read_recording(path)
    arrays = {
        name: hashlib.sha256(f"{a.dtype.str} {a.shape}".encode() + np.ascontiguousarray(a).tobytes()).hexdigest()
        for name, a in sorted(recording.arrays.items())
    }
    score = score_recording(recording).model_dump(mode="json")
    return {"sha256": recording.stored_sha256, "arrays": arrays, "score": score}


def equal(before: Any, now: Any, *, bitwise: bool) -> bool:
    """Whether nothing that was there has moved; what a later release adds does not count."""
    if not bitwise:
        return same(before, now)
    if isinstance(before, dict):
        return isinstance(now, dict) and all(k in now and equal(v, now[k], bitwise=True) for k, v in before.items())
    return type(before) is type(now) and before == now


@pytest.mark.parametrize("name", FILES)
def test_arrays_and_scores_are_as_they_were(name: str) -> None:
    expected = json.loads(EXPECTED.read_text())
    before, now = expected["files"][name], found_in(FOLDER / name)
    assert now["sha256"] == before["sha256"]
    assert {path: now["arrays"].get(path) for path in before["arrays"]} == before["arrays"]
    bitwise = expected["cpu"] == cpu()
    moved = {
        field: (value, now["score"].get(field))
        for field, value in before["score"].items()
        if not equal(value, now["score"].get(field), bitwise=bitwise)
    }
    assert moved == {}


def test_a_last_bit_that_moved_is_seen() -> None:
    value = 0.1
    assert equal({"a": value}, {"a": value, "b": 1}, bitwise=True)
    assert not equal({"a": value}, {"a": float(np.nextafter(value, 1))}, bitwise=True)
    assert equal({"a": value}, {"a": float(np.nextafter(value, 1))}, bitwise=False)
    assert not equal({"a": None}, {"a": 0.0}, bitwise=True)


def main() -> None:
    content = {"cpu": cpu(), "files": {name: found_in(FOLDER / name) for name in FILES}}
    EXPECTED.write_text(json.dumps(content, indent=1, sort_keys=True) + "\n")


if __name__ == "__main__":
    main()

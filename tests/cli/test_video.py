"""Which failures of a run are filmed without being asked for."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from carecontact.cli.view import MOST_FAILURES, VideoGroup, film_failures
from carecontact.errors import RecordingError


def score(number: int, mode: str | None, *, crash: bool = False) -> Any:
    return SimpleNamespace(trial_id=f"T1-s{number:03d}", failure_mode=mode, attribution="execution", is_crash=crash)


def test_the_first_failure_of_each_cause_is_filmed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    filmed: list[str] = []

    def write(group: VideoGroup, place: Path, *, out: Path | None, fps: float | None) -> int:
        assert (group.draft, place.parent) == (True, tmp_path)
        filmed.append(place.stem)
        if len(filmed) == 1:
            raise RecordingError("T1-s002: salted")
        return 0

    monkeypatch.setattr(VideoGroup, "write", write)
    modes = [None, "process_failure", "a", "a", "b", "c", "d"]
    film_failures(tmp_path, [score(k, mode, crash=mode == "process_failure") for k, mode in enumerate(modes)])
    assert filmed == ["T1-s002", "T1-s004", "T1-s005"]
    assert len(filmed) == MOST_FAILURES
    assert capsys.readouterr().out == "no video of T1-s002: T1-s002: salted\n", "and the others are filmed"

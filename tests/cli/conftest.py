"""Fixtures of other rooms that tests of commands use."""

from __future__ import annotations

import functools
from pathlib import Path

import pytest

import carecontact
from carecontact.report import baselines
from carecontact.running import supervisor
from tests.replay.conftest import pressed, pressed_file
from tests.running.forked_fakes import FAKE, fork_fakes
from tests.sensing.test_segmentation import weights

__all__ = ["pressed", "pressed_file", "weights"]


@pytest.fixture
def fake(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> pytest.MonkeyPatch:
    """Runs of the command line have workers that only write recordings, and no kept scores stand beside them."""
    monkeypatch.setattr(baselines, "shipped_scores_for", lambda run, named, folders=(): ([], "None is kept."))
    monkeypatch.setattr(supervisor, "run_trials", functools.partial(supervisor.run_trials, worker_command=FAKE))
    fork_fakes(monkeypatch)
    monkeypatch.setenv("FAKE_LOG", str(tmp_path / "ran.txt"))
    monkeypatch.setenv("FAKE_PLAN", "{}")
    monkeypatch.setenv("PYTHONPATH", str(Path(carecontact.__file__).parents[1]))
    monkeypatch.chdir(tmp_path)
    return monkeypatch

from __future__ import annotations

import pytest

from tests.reports.synthetic_run import Run, fill


@pytest.fixture
def run_of_7() -> Run:
    run = Run()
    fill(run, 0)
    return run


@pytest.fixture(scope="session")
def run_of_42() -> Run:
    run = Run()
    for seed in range(6):
        fill(run, seed)
    return run

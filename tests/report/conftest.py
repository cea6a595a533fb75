from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.report.browser import NAMES, Browser, found
from tests.report.synthetic import Run, fill


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


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    """Skips where there is no Chromium."""
    program = found()
    if program is None:
        pytest.skip(f"no browser to open the page in: none of {', '.join(NAMES)} is on the PATH")
    with Browser(program, tmp_path_factory.mktemp("profile")) as running:
        yield running

"""The hidden folder in a run's folder where its trials are written until they are finished."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from carecontact.recording.writer import TEMPORARY

WORK_PREFIX = ".running-"


@contextmanager
def work_folder(out: Path) -> Iterator[Path]:
    with tempfile.TemporaryDirectory(prefix=WORK_PREFIX, dir=out) as folder:
        yield Path(folder)


def remove_abandoned(out: Path) -> None:
    """Remove what a killed command left in ``out``. Call it where no other command can be at work there."""
    for folder in out.glob(f"{WORK_PREFIX}*"):
        shutil.rmtree(folder, ignore_errors=True)
    for file in out.glob(f".*{TEMPORARY}"):
        file.unlink(missing_ok=True)

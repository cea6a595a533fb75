"""The hidden folder in a run's folder where its trials are written until they are finished."""

from __future__ import annotations

import fcntl
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from carecontact.errors import ConfigError

WORK_PREFIX = ".running-"
LOCK = "lock"


@contextmanager
def work_folder(out: Path) -> Iterator[Path]:
    """Make a folder that is locked for as long as this process lives, however it ends."""
    with tempfile.TemporaryDirectory(prefix=WORK_PREFIX, dir=out) as folder, (Path(folder) / LOCK).open("w") as stream:
        fcntl.flock(stream, fcntl.LOCK_EX)
        yield Path(folder)


def remove_abandoned(out: Path) -> None:
    """Remove what a killed command left in ``out``. Raises ConfigError while a living one is at work there."""
    for folder in out.glob(f"{WORK_PREFIX}*"):
        lock = folder / LOCK
        if lock.is_file():
            with lock.open() as stream:
                try:
                    fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
                except BlockingIOError:
                    raise ConfigError(
                        f"{out}: another command is writing trials to this folder; wait until it has ended, or use "
                        "another --out"
                    ) from None
        shutil.rmtree(folder, ignore_errors=True)

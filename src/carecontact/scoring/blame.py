"""A fault in what a package supplies, in one line that names it, its package and the trial."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from traceback import extract_tb

from carecontact.errors import CarecontactError, ConfigError


@contextmanager
def blamed_on(what: str, trial_id: str) -> Generator[None]:
    """Any error inside the block that is not carecontact's own becomes a ConfigError.

    Args:
        what: whose code the block calls, as ``Registry.title`` names it.
    """
    try:
        yield
    except CarecontactError:
        raise
    except Exception as error:  # a stranger's code may raise anything
        place = extract_tb(error.__traceback__)[-1]
        why = f"{type(error).__name__}: {' '.join(str(error).split())}".rstrip(": ")
        raise ConfigError(
            f"{what} failed in trial {trial_id}: {why} ({Path(place.filename).name}, line {place.lineno})"
        ) from error


def shown(answer: object) -> str:
    """Return an answer as a message shows it: the beginning of its repr, in one line."""
    return " ".join(repr(answer).split())[:60]

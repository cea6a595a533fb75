from __future__ import annotations

from collections.abc import Callable
from functools import cache
from importlib import import_module

import pytest

from carecontact.protocols import load_protocol
from carecontact.validation.result import CheckResult
from carecontact.validation.run import CHECKS
from carecontact.validation.subject import Subject


@pytest.fixture(scope="session")
def subject() -> Subject:
    """The shipped person; built and settled once."""
    return Subject(load_protocol())


@pytest.fixture(scope="session")
def short_form(subject: Subject) -> Callable[[str], CheckResult]:
    """Name of a check -> what its short form finds on the shipped person; each runs once."""
    return cache(lambda name: import_module(f"carecontact.validation.{CHECKS[name]}").run(subject, quick=True))

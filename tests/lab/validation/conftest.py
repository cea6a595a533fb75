from __future__ import annotations

from collections.abc import Callable
from functools import cache
from importlib import import_module

import pytest

from carecontact.lab.validation.result import CheckResult
from carecontact.lab.validation.run import CHECKS
from carecontact.lab.validation.subject import Subject
from carecontact.protocol.load import load_protocol


@pytest.fixture(scope="session")
def subject() -> Subject:
    """The shipped person; built and settled once."""
    return Subject(load_protocol("bathing-v3"))


@pytest.fixture(scope="session")
def short_form(subject: Subject) -> Callable[[str], CheckResult]:
    """Name of a check -> what its short form finds on the shipped person; each runs once."""
    return cache(lambda name: import_module(f"carecontact.lab.validation.{CHECKS[name]}").run(subject, quick=True))

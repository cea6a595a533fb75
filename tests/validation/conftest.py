from __future__ import annotations

import pytest

from carecontact.protocols import load_protocol
from carecontact.validation.subject import Subject


@pytest.fixture(scope="session")
def subject() -> Subject:
    """The shipped person; built and settled once."""
    return Subject(load_protocol())

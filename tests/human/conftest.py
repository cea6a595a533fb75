from __future__ import annotations

import pytest

from carecontact.human.body import Body
from carecontact.human.library import body_names, load_body


@pytest.fixture(scope="session", params=body_names())
def body(request: pytest.FixtureRequest) -> Body:
    return load_body(request.param)

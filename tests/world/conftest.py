from __future__ import annotations

import pytest

from carecontact.world.human.body import Body
from carecontact.world.human.library import body_names, load_body


@pytest.fixture(scope="session", params=body_names())
def body(request: pytest.FixtureRequest) -> Body:
    return load_body(request.param)

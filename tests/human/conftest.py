from __future__ import annotations

import pytest

from carecontact.human.body import Body
from carecontact.human.library import body_names, load_body

QUICK = ("man-adult", "woman-old-light", "man-adult-heavy")
SOME_QUICK = [pytest.param(name, marks=[] if name in QUICK else pytest.mark.slow) for name in body_names()]
"""All bodies, of which only those between the extremes are slow."""


@pytest.fixture(scope="session", params=body_names())
def body(request: pytest.FixtureRequest) -> Body:
    return load_body(request.param)

"""Fixtures that several layers share. The simulator is imported only by the tests that ask for it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cache
from typing import TYPE_CHECKING

import pytest
from hypothesis import settings

# Wall clock says nothing on a shared machine; and CI must not turn red by the luck of a draw: new draws are for
# `pytest --hypothesis-profile=search`.
settings.register_profile("repeatable", deadline=None, derandomize=True)
settings.register_profile("search", deadline=None, max_examples=500)
settings.load_profile("repeatable")

if TYPE_CHECKING:
    from carecontact.world.scene import Scene


@pytest.fixture(scope="session", autouse=True)
def no_files_at_home(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Settled states that tests keep, in this process and in those that they start, go to a folder of their own."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CARECONTACT_CACHE", str(tmp_path_factory.mktemp("cache")))
        yield


@pytest.fixture(scope="session")
def scene_of() -> Callable[[str | None], Scene]:
    """Target region -> the compiled scene of the default protocol with the visible skin; read only, built once."""
    from carecontact.protocols import load_protocol
    from carecontact.world.scene import build_scene

    return cache(lambda target: build_scene(load_protocol(), target=target))

"""Fixtures that several layers share. The simulator is imported only by the tests that ask for it."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from functools import cache, wraps
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import settings

# Wall clock says nothing on a shared machine; and CI must not turn red by the luck of a draw: new draws are for
# `pytest --hypothesis-profile=search`.
settings.register_profile("repeatable", deadline=None, derandomize=True)
settings.register_profile("search", deadline=None, max_examples=500)
settings.load_profile("repeatable")

if TYPE_CHECKING:
    from carecontact.protocol.protocol import Protocol
    from carecontact.world.scene import Scene


@pytest.fixture(scope="session", autouse=True)
def no_files_at_home(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Settled states that tests keep, in this process and in those that they start, go to a folder of the run's own.

    Workers of pytest-xdist share it: each has a base folder of its own beside those of the others.
    """
    base = tmp_path_factory.getbasetemp()
    folder = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "settled-states"
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CARECONTACT_CACHE", str(folder))
        yield


def pytest_runtest_setup() -> None:
    """From now on a world is described once a process; each call still compiles a model of its own from that.

    Checked before every test, because the simulator is imported by the tests that need it and not here.
    """
    scene = sys.modules.get("carecontact.world.scene")
    if scene is not None and not hasattr(scene.build_spec, "__wrapped__"):
        scene.build_spec = described_once(scene.build_spec)


def described_once(build_spec: Callable[..., Any]) -> Callable[..., Any]:
    known: dict[tuple[str, str | None, bool], Any] = {}

    @wraps(build_spec)
    def described(protocol: Protocol, *, target: str | None, skin: bool = True) -> Any:
        key = (protocol.model_dump_json(), target, skin)
        if key not in known:
            known[key] = build_spec(protocol, target=target, skin=skin)
        return known[key]

    return described


@pytest.fixture(params=["", "off"], ids=["namespaces", "no namespaces"])
def sandbox(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> bool:
    """Whether policies run in namespaces: both kinds of systems, as far as this one grants namespaces."""
    from carecontact.serving.namespaces import VARIABLE, granted

    monkeypatch.setenv(VARIABLE, request.param)
    if not request.param and not granted():
        pytest.skip("this system grants no namespaces")
    return granted()


@pytest.fixture
def worlds_from_scratch(monkeypatch: pytest.MonkeyPatch) -> None:
    """For tests of whether two builds agree."""
    from carecontact.world import scene

    monkeypatch.setattr(scene, "build_spec", getattr(scene.build_spec, "__wrapped__", scene.build_spec))


@pytest.fixture(scope="session")
def scene_of() -> Callable[[str | None], Scene]:
    """Target region -> the compiled scene of the default protocol with the visible skin; read only, built once."""
    from carecontact.protocol.load import load_protocol
    from carecontact.world.scene import build_scene

    return cache(lambda target: build_scene(load_protocol("bathing-v3"), target=target))

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from carecontact.audit.keyframe import Keyframe
from carecontact.audit.watched import Watched, press
from carecontact.contract.policy import PolicyCard
from carecontact.contract.trial import TrialSpec
from carecontact.protocols import load_protocol

BLIND = PolicyCard(name="blind")


@pytest.fixture(scope="session")
def keyframe() -> Keyframe:
    return Keyframe(load_protocol(), task_id="T1", seed=0)


@pytest.fixture(scope="session")
def spec() -> TrialSpec:
    return TrialSpec(protocol=load_protocol(), task_id="T1", seed=0, policy="")


Press = Callable[..., Watched]


@pytest.fixture
def blind_press(keyframe: Keyframe, spec: TrialSpec, tmp_path: Path) -> Press:
    """A logged press by a witness that sees nothing but its encoders."""

    def run() -> Watched:
        return press(
            spec, card=BLIND, poses=keyframe.poses, prepare=keyframe.near, folder=tmp_path / "witness",
            log=tmp_path / "logs" / "press",
        )  # fmt: skip

    return run

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from carecontact.audit.finding import Part
from carecontact.audit.watched import Keyframe, Watched, press
from carecontact.interface.policy import PolicyCard
from carecontact.protocol.load import load_protocol
from carecontact.protocol.protocol import TrialSpec
from carecontact.serving import codec
from carecontact.sim.simulation import Samples, Simulation

Press = Callable[..., Watched]
BLIND = PolicyCard(name="blind")


def send_a_privileged_key(monkeypatch: pytest.MonkeyPatch) -> None:
    """With every observation from now on."""
    honest = codec.pack

    def leaky(message: dict[str, Any]) -> bytes:
        if message["type"] == "act":
            message["observation"]["contact_force"] = 3.5
        return honest(message)

    monkeypatch.setattr(codec, "pack", leaky)


@pytest.fixture(scope="session")
def keyframe() -> Keyframe:
    return Keyframe(load_protocol("bathing-v3"), task_id="T1", seed=0)


@pytest.fixture(scope="session")
def spec() -> TrialSpec:
    return TrialSpec(protocol=load_protocol("bathing-v3"), task_id="T1", seed=0, policy="")


@pytest.fixture
def blind_press(keyframe: Keyframe, spec: TrialSpec, tmp_path: Path) -> Press:
    """A logged press by a witness that sees nothing but its encoders, at every action."""

    def run() -> Watched:
        return press(
            spec, card=BLIND, poses=keyframe.poses, prepare=keyframe.near, actions_per_look=1,
            folder=tmp_path / "witness", log=tmp_path / "logs" / "press",
        )  # fmt: skip

    return run


class LastForce:
    """[N] of the latest physics steps: a force that no field of the simulator's data has to hold."""

    newton = 0.0


@pytest.fixture
def last_force(monkeypatch: pytest.MonkeyPatch) -> LastForce:
    last, advance = LastForce(), Simulation.advance

    def remembered(self: Simulation, steps: int) -> list[Samples]:
        samples = advance(self, steps)
        last.newton = float(np.abs(samples[-1].force).sum())
        return samples

    monkeypatch.setattr(Simulation, "advance", remembered)
    return last


def places(part: Part) -> set[str]:
    return {finding.place for finding in part.findings}

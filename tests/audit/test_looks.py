"""The audit on looks on request: an honest trial passes every part, and a look that was not due fails."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

import numpy as np
import pytest

from carecontact.audit.run import audit_derivation, audit_readings
from carecontact.audit.schema import Timetable, audit_schema
from carecontact.audit.watched import Keyframe, Watched, watch
from carecontact.episode.looks import Looks
from carecontact.interface.policy import PolicyCard
from carecontact.protocol.protocol import TrialSpec
from carecontact.serving.conversation import PolicySetup
from carecontact.sim.impedance import steps_of_period
from tests.audit.conftest import places

ASKS = """
from carecontact.interface.action import Action
from carecontact.interface.policy import PolicyCard

class Asks:
    card = PolicyCard(
        name="asks", modalities=("rgb",), cameras=("overhead", "wrist"), control_hz=20,
        camera_hz={"overhead": 0, "wrist": 10},
    )
    def reset(self, instruction):
        self.acts = 0
    def act(self, observation):
        self.acts += 1
        return Action(look=("overhead",) if self.acts == 4 else (), done=self.acts == 6)
"""


@pytest.fixture
def asks(keyframe: Keyframe, spec: TrialSpec, tmp_path: Path) -> Watched:
    (tmp_path / "asking.py").write_text(ASKS)
    setup = PolicySetup.of("asking:Asks", search_path=[str(tmp_path)])
    spec = spec.model_copy(update={"policy": "asking:Asks"})
    watched = watch(spec, policy="asks", prepare=keyframe.parked, log=tmp_path / "logs" / "asks", setup=setup)
    assert watched.error is None
    return watched


def test_an_honest_trial_passes_and_every_picture_is_drawn_again(asks: Watched, tmp_path: Path) -> None:
    assert asks.recording is not None
    assert asks.recording["policy/looked"][:, [0, 3]].tolist() == [[1, 1], [0, 0], [0, 1], [0, 0], [1, 1], [0, 0]]
    assert audit_schema([asks]).passed
    assert audit_derivation(tmp_path / "logs", []).findings == ()
    readings = audit_readings(tmp_path / "logs", [asks])
    assert readings.passed
    assert readings.counts == {"looks": 6, "looks timed": 6, "images drawn again": 5}


@pytest.fixture
def planted(monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> Watched:
    """A trial whose observation at 0.05 s shows a camera that is not due, or at 0.1 s lacks one that is."""
    honest, more = Looks.due, request.param

    def wrong(self: Looks, sim_time_s: float) -> tuple[str, ...]:
        due = honest(self, sim_time_s)
        if more and sim_time_s == pytest.approx(0.05):
            return (*due, "overhead")
        return () if not more and sim_time_s == pytest.approx(0.1) else due

    monkeypatch.setattr(Looks, "due", wrong)
    return request.getfixturevalue("asks")


@pytest.mark.parametrize(
    ("planted", "detail"),
    [
        (True, "due by card and actions are none, but the message holds ['overhead']"),
        (False, "due by card and actions are ['wrist'], but the message holds []"),
    ],
    indirect=["planted"],
)
def test_a_look_that_was_not_due_or_is_missing(planted: Watched, detail: str) -> None:
    part = audit_schema([planted])
    assert places(part) == {"observation.cameras"}
    assert [finding.detail for finding in part.findings] == [detail]


@pytest.mark.parametrize("hz", [0.0, 0.7, 5.0, 7.0, 15.0, 50.0])
@pytest.mark.parametrize("control_hz", [7.0, 15.0, 20.0, 50.0])
def test_two_timetables_that_share_no_code_agree(hz: float, control_hz: float) -> None:
    dt_s, rng = 0.002, np.random.default_rng(0)
    card = PolicyCard(name="p", cameras=("overhead", "wrist"), control_hz=control_hz, camera_hz={"wrist": hz})
    looks, timetable = Looks(card, dt_s=dt_s), Timetable(card, early_s=dt_s)
    asked: Collection[str] = ()
    step, taken = 0, 0
    for number, period in zip(range(1500), steps_of_period(control_hz, dt_s), strict=False):
        looks.ask(asked)
        due = looks.due(step * dt_s)
        assert set(due) == timetable.due(step * dt_s, asked), (number, step * dt_s)
        taken += "wrist" in due
        asked = ("wrist",) if rng.random() < 0.05 else ()
        # A chunk of several actions now and then, and a latency that is no whole number of periods.
        step += period * (1 if rng.random() < 0.8 else int(rng.integers(2, 90))) + int(rng.integers(0, 3))
    assert 30 <= taken
    assert hz >= control_hz or taken < 1500

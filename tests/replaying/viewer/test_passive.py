"""The keys of the passive viewer, its states, and a machine without a display."""

from __future__ import annotations

import pytest

from carecontact.errors import DependencyError
from carecontact.recording import Recording
from carecontact.replaying.replay import Replay
from carecontact.replaying.viewer import passive


def test_keys_pause_and_skip() -> None:
    player = passive.Player(count=100, fps=10.0)
    assert player.advance(2.0) == 20
    player.key(passive.SPACE)
    assert player.advance(5.0) == 20
    player.key(passive.RIGHT)
    assert player.advance(0.0) == 30
    for _ in range(9):
        player.key(passive.LEFT)
    assert player.advance(0.0) == 0
    player.key(passive.SPACE)
    assert player.advance(100.0) == 99, "the last state stays"
    player.key(passive.HOME)
    assert player.advance(0.0) == 0


def test_all_states_have_positions_and_the_robot_moves(pressed: Recording) -> None:
    replay = Replay(pressed)
    rows = passive.positions(replay, 5.0)
    joint = int(replay.model.joint("robot_joint1").qposadr[0])
    assert rows.shape == (int(len(pressed["scorer/time_s"]) * 0.002 * 5) + 1, replay.model.nq)
    assert rows[:, joint].std() > 0.01


def test_without_a_display_the_error_names_what_works(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(passive.sys, "platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(DependencyError, match=r"no display.*--save FILE\.rrd"):
        passive.need_display()
    monkeypatch.setenv("DISPLAY", ":0")
    passive.need_display()

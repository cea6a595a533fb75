from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from carecontact.oracle.press import PATIENCE_S, STEADY_S, Press, Stage
from carecontact.policies.motion import CONTROL_HZ
from carecontact.protocols import load_protocol

DOWN = np.array([0.5, 0.0, 0.3, 0.0, 1.0, 0.0, 0.0])
PRESSES = 10


class Skin:
    """A person who lies still and gives back the forces of a list, one in each control period, and then the last."""

    def __init__(self, forces_n: list[float], *, sideways_n: float = 0.0) -> None:
        self.forces_n, self._sideways_n = forces_n, sideways_n
        self.simulation = SimpleNamespace(protocol=load_protocol())

    def frame(self) -> np.ndarray:
        return np.eye(4)

    def force_n(self) -> float:
        return self.forces_n.pop(0) if len(self.forces_n) > 1 else self.forces_n[0]

    def force(self) -> np.ndarray:
        return np.array([self._sideways_n, 0.0, -1.0])


def run(skin: Any, *, rests: bool) -> tuple[Press, int]:
    """The press at its end, and the number of its control periods."""
    press, count = Press(skin, [Stage(pose=DOWN, presses=True)] * PRESSES, rests=rests), 0
    while not press.ended:
        press.act()
        count += 1
    return press, count


@pytest.mark.parametrize("lost_n", [0.0, 20.0])
def test_a_touch_begins_anew_when_the_person_takes_the_skin_away_or_brings_it_up(lost_n: float) -> None:
    steady = round(STEADY_S * CONTROL_HZ)
    held = [3.0] * (steady - 4)
    press, count = run(Skin([*held, lost_n, *held, lost_n, 3.0]), rests=True)
    assert press.succeeded
    assert count == 2 * (len(held) + 1) + steady


def test_a_stroke_does_not_wait_for_a_steady_force() -> None:
    _, count = run(Skin([3.0, 20.0] * PRESSES), rests=False)
    assert count == PRESSES


def test_patience_ends() -> None:
    press, count = run(Skin([9.0]), rests=True)
    assert not press.succeeded
    assert count == PRESSES + PATIENCE_S * CONTROL_HZ


def test_the_target_leads_by_what_friction_takes() -> None:
    """2 N of friction on a spring of 400 N/m: 5 mm."""
    press: Any = Press(Skin([3.0], sideways_n=2.0), [Stage(pose=DOWN, presses=True)] * 40, rests=False)  # pyright: ignore[reportArgumentType]
    places = [press.act().pose_tcp_in_base for _ in range(40)]
    assert places[-1][0] - DOWN[0] == pytest.approx(0.005, abs=1e-4)
    assert places[-1][1] == DOWN[1]

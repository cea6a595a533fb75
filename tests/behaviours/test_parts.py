"""The requirements of a gate one by one: all of them are met exactly where the gate is."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from carecontact.contract.protocol import Protocol
from carecontact.scoring.ask import ask
from carecontact.scoring.contact import find_contact
from carecontact.scoring.gate import GatePart
from carecontact.scoring.metrics.c3_success import judge
from tests.scoring.exam_gates import GENTLE
from tests.scoring.synthetic import PROTOCOL, SIZE, hold, make_recording, push, scrub, seconds


def parts_of(recording: Any) -> tuple[list[GatePart], bool]:
    contact = find_contact(recording)
    gate = judge(contact)
    found = ask(contact, "parts", contact, contact.protocol.gates.of(contact.task.action), gate)
    return found, gate.time_met and gate.progress_met and gate.band_met


@pytest.mark.parametrize("protocol", [PROTOCOL, GENTLE], ids=["paper", "exam"])
@given(data=st.data())
@settings(max_examples=25, deadline=None)
def test_all_parts_are_met_exactly_where_the_gate_is(protocol: Protocol, data: st.DataObject) -> None:
    force, length = data.draw(st.floats(0.2, 9.0)), data.draw(st.floats(0.1, 3.5))
    action = data.draw(st.sampled_from(["T1", "T2", "T3"]))
    t = seconds(5.0)
    tip = np.zeros((len(t), 3))
    tip[:, 0] = data.draw(st.floats(0.0, 0.09)) * np.sin(2 * np.pi * t / data.draw(st.floats(0.5, 4.0)))
    tip[:, 2] = SIZE["forearm"][2]
    wrist = np.clip((t - 1.0) / length, 0, 1) * data.draw(st.floats(0.0, 0.13))
    found, passed = parts_of(
        make_recording(
            action,
            duration=5.0,
            normal={"right_forearm": hold(5.0, 1.0, 1.0 + length, force)},
            tcp_in_region=tip,
            wrist_shift=wrist,
            protocol=protocol,
        )
    )
    assert found
    assert all(part.met for part in found) is passed


@pytest.mark.parametrize(
    ("recording", "missed"),
    [
        (push(), []),
        (push(force=2.0), [("Pressed with at least 3 N without interruption", "1 s", "0.00 s (largest force 2.0 N)")]),
        (push(shift=0.012), [("Distance the wrist moved while the arm is touched", "at least 20 mm", "12.0 mm")]),
        (push(shift=0.15, protocol=GENTLE),
         [("Distance the wrist moved from where it was when the contact began", "20 mm to 100 mm", "150.0 mm")]),
        (scrub(amplitude=0.015), [
            ("Distance the tool moved along the skin", "at least 100 mm", "104.0 mm"),
            ("Length of the region that it covers", "at least 50 mm", "30.0 mm"),
        ][1:]),
    ],
)  # fmt: skip
def test_what_was_missed_is_told_with_what_was_needed(recording: Any, missed: list[tuple[str, str, str]]) -> None:
    found, _ = parts_of(recording)
    told = [(part.name, part.needed, part.reached) for part in found if not part.met]
    assert [(name, needed) for name, needed, _ in told] == [(name, needed) for name, needed, _ in missed]
    for (_, _, reached), (_, _, known) in zip(told, missed, strict=True):
        assert reached.split()[1:] == known.split()[1:]
        assert float(reached.split()[0]) == pytest.approx(float(known.split()[0]), abs=1.5)

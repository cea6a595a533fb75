"""Contacts of which the cells feel a known share: numbers about pressure exist where it is most of the force."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from carecontact.recording import Recording
from carecontact.scoring import METRICS
from carecontact.scoring.contact import find_contact
from tests.scoring.metrics.test_cells import Wipe, recording_of
from tests.scoring.synthetic import make_recording, push

OF_CELLS = (
    "pressure_mean", "pressure_peak", "exposure_uncomfortable", "exposure_fragile", "comfortable",
    "comfortable_fragile", "pressure_utilisation", "shear_dose",
)  # fmt: skip


def felt(share: float, segment: str = "right_forearm") -> Recording:
    """A light wipe, and beside the cells so much force on a segment that the cells feel this share of it all."""
    made = recording_of(Wipe(pressure_pa=1000.0))
    normal = made["scorer/normal_force"].copy()
    column, forearm = (made.header.segments.index(name) for name in (segment, "right_forearm"))
    normal[:, column] += normal[:, forearm] * (1 / share - 1)
    return replace(made, arrays=made.arrays | {"scorer/normal_force": normal})


def values(recording: Recording) -> dict[str, float | None]:
    contact = find_contact(recording)
    return {name: METRICS[f"{name}@2"].compute(contact) for name in OF_CELLS}


@pytest.mark.parametrize("segment", ["right_forearm", "abdomen"])
@pytest.mark.parametrize("share", [0.02, 0.4, 0.6, 1.0])
def test_the_share_is_that_of_the_force_on_all_segments(share: float, segment: str) -> None:
    found = METRICS["cell_share@1"].compute(find_contact(felt(share, segment)))
    assert found == pytest.approx(share, rel=1e-3)


def test_a_press_beside_the_cells_is_no_comfortable_wipe() -> None:
    """It is a light brush of the cells beside a hard press."""
    assert values(felt(1.0))["comfortable"] == 1.0
    assert values(felt(0.02)) == dict.fromkeys(OF_CELLS)


def test_where_the_cells_felt_most_of_the_force_the_rest_does_not_count() -> None:
    assert values(felt(0.6)) == values(felt(1.0))
    assert None not in values(felt(0.6)).values()


def test_without_cells_or_force_there_is_no_share() -> None:
    compute = METRICS["cell_share@1"].compute
    assert compute(find_contact(push())) is None
    untouched = recording_of(Wipe())
    still = {name: np.zeros_like(untouched[name]) for name in ("scorer/normal_force", "scorer/cell_press_ns")}
    assert compute(find_contact(replace(untouched, arrays=untouched.arrays | still))) is None
    assert compute(find_contact(make_recording())) is None
    pressed = replace(untouched, arrays=untouched.arrays | {"scorer/cell_press_ns": still["scorer/cell_press_ns"]})
    assert compute(find_contact(pressed)) == 0.0

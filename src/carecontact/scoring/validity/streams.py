"""The checks that the scorer's streams must pass before a score is computed from them."""

from __future__ import annotations

from carecontact.recording import Recording
from carecontact.scoring.validity.forces import check_forces
from carecontact.scoring.validity.times import check_times
from carecontact.scoring.validity.values import (
    check_bounds,
    check_cells,
    check_finite_streams,
    check_joint_ranges,
    check_reactions,
    check_rotations,
)


def check_streams(recording: Recording) -> None:
    """Raises RecordingError naming the trial, the array, the place in it and what would be valid.

    The checks are ``check_finite_streams``, ``check_times``, ``check_bounds``, ``check_cells``, ``check_rotations``,
    ``check_joint_ranges``, ``check_reactions`` and ``check_forces``. They do not find what is wrong by less than their
    generous bounds: 5 % on every force, a wrist shifted by 1 cm. A trial that the solver cut needs only finite values
    and clocks that agree. Whether an action may be executed is decided in ``Episode.step``, and not once more here.
    """
    check_finite_streams(recording)
    check_times(recording)
    header = recording.header
    diverged = header.ended == "safety_truncation" and header.failure is not None and header.failure.kind == "solver"
    # Diverging physics knows no bounds. Refused, such a trial would be lost; scored, it is a failed one.
    if len(recording["scorer/time_s"]) == 0 or diverged:
        return
    check_bounds(recording)
    check_cells(recording)
    check_rotations(recording)
    check_joint_ranges(recording)
    check_reactions(recording)
    check_forces(recording)

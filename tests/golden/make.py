"""Write the golden recordings and their scores: ``python -m tests.golden.make`` from the repository's root.

Synthetic signals, no simulation. Run it when a definition or the schema changes on purpose, and say so in the commit:
the scores of recordings that stand must not move by themselves.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from carecontact.recording import SEGMENTS, Recording, write_recording
from carecontact.runs import score_run
from tests.scoring.synthetic import (
    DT,
    F64,
    JOINTS,
    back_and_forth,
    before_start,
    hold,
    make_recording,
    seconds,
    target_segment,
)

FOLDER = Path(__file__).parent
SCORES = FOLDER / "scores.json"
DRAG = 0.3


def wavy(duration: float, start: float, stop: float, force: float, depth: float) -> F64:
    """(T,) a hold that trembles with two frequencies [N]."""
    t = seconds(duration)
    waves = np.sin(2 * np.pi * 3.7 * t) + 0.3 * np.sin(2 * np.pi * 41.0 * t)
    return hold(duration, start, stop, 1.0) * (force + depth * waves)


def golden() -> Iterator[Recording]:
    """A gentle touch, a push that slips to the hand, a scrub, a scrub too hard, one beside its region, one that
    touched no one and one whose policy died."""
    target = [(0.1, (0.0, 0.0, 0.04)), (0.5, (0.05, 0.0, 0.03))]
    yield make_recording("T1", duration=1.0, normal={"right_forearm": wavy(1.0, 0.2, 0.9, 6.0, 1.5)})
    joints = np.ones((800, len(JOINTS)))
    joints[:, 0] = np.linspace(1.0, 2.52, 800)
    yield make_recording(
        "T2",
        duration=1.6,
        normal={"right_forearm": wavy(1.6, 0.2, 1.5, 9.0, 2.0), "right_hand": wavy(1.6, 1.0, 1.4, 2.0, 0.5)},
        wrist_shift=np.clip(seconds(1.6) - 0.2, 0, 1) * 0.04,
        joints=joints,
    )
    for task_id, force in (("T3", 8.0), ("T7", 30.0)):
        path = back_and_forth(2.0, task_id_region(task_id), amplitude=0.06, period=1.0)
        recording = make_recording(
            task_id, duration=2.0, normal={target_segment(task_id): wavy(2.0, 0.2, 1.9, force, 2.0)}, tcp_in_region=path
        )
        column = SEGMENTS.index(target_segment(task_id))
        drag = DRAG * recording["scorer/normal_force"][:, column] * np.sign(np.gradient(path[:, 0], DT))
        force = recording["scorer/force_human_from_robot_in_world"].copy()
        force[:, column, 0] = drag
        yield replace(recording, arrays={**recording.arrays, "scorer/force_human_from_robot_in_world": force})
    beside = {"right_forearm": wavy(1.0, 0.2, 0.9, 5.0, 1.0), "right_upper_arm": wavy(1.0, 0.7, 0.9, 2.0, 0.2)}
    yield make_recording("T4", duration=1.0, normal=beside, targets_in_region=target)
    yield make_recording("T6", duration=0.4, targets_in_region=target, ended="time_limit")
    died = before_start()
    spec = died.header.spec.model_copy(update={"task_id": "T5"})
    yield Recording(header=died.header.model_copy(update={"spec": spec}), arrays=died.arrays)


def task_id_region(task_id: str) -> str:
    return {"T3": "forearm", "T7": "abdomen"}[task_id]


def main() -> None:
    for path in FOLDER.glob("*.h5"):
        path.unlink()
    for recording in golden():
        write_recording(recording, FOLDER / f"{recording.header.spec.trial_id}.h5")
    scores = {s.trial_id: s.model_dump(mode="json") for s in score_run(FOLDER).scores}
    SCORES.write_text(json.dumps(scores, indent=1, sort_keys=True) + "\n")


if __name__ == "__main__":
    main()

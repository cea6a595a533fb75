"""What an uncertain shoulder and board change in a push: T2 of ``state-machine`` on people of a protocol's level.

    python tools/push_sensitivity.py --seeds 0-8

Each row is one change of the shipped person; a cell has the median over the trials and the smallest and largest value.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from functools import partial

import numpy as np

from carecontact.episode.randomization import World, settled_world
from carecontact.human.joints import SHOULDER_NM_RAD, SHOULDER_RANGE_NM_RAD
from carecontact.protocol.load import load_protocol
from carecontact.protocol.overrides import overridden
from carecontact.protocol.protocol import Protocol, TrialSpec
from carecontact.running.trial import run_trial
from carecontact.runs.plan import parse_seeds
from carecontact.scoring.result import TrialScore
from carecontact.scoring.score import score_recording

TASK, POLICY = "T2", "state-machine"
FRICTIONS = (0.15, 0.6)
"""Half and twice the declared friction of the board."""
HEADS = ("shoulder [N m/rad]", "board friction", "passed", "largest force [N]", "wrist moved since contact [mm]",
         "wrist bends [deg]")  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--protocol", default="bathing-wide-v2")
    parser.add_argument("--level", default="L1")
    parser.add_argument("--seeds", default="0-8")
    given = parser.parse_args()
    protocol = load_protocol(given.protocol, level=given.level)
    seeds = parse_seeds(given.seeds, protocol=protocol)
    shipped = protocol.scene.board_friction
    print(f"| {' | '.join(HEADS)} |\n|{'---|' * len(HEADS)}")
    for stiffness in (SHOULDER_NM_RAD, *SHOULDER_RANGE_NM_RAD):
        print(row(protocol, seeds, stiffness), flush=True)
    for friction in FRICTIONS:
        changed = overridden(protocol, {"scene.board_friction": friction})
        print(row(changed, seeds, SHOULDER_NM_RAD), flush=True)
    print(f"\n{len(seeds)} trials a row; shipped: {SHOULDER_NM_RAD:g} N m/rad and {shipped:g}")


def row(protocol: Protocol, seeds: list[int], stiffness: float) -> str:
    """Run one trial for each seed; ``stiffness``: of man-adult's shoulder [N m/rad], others in proportion."""
    scores, bends = zip(*(pushed(protocol, seed, stiffness) for seed in seeds), strict=True)
    moved = [1000 * way for score in scores if (way := score.additional["wrist_from_onset@1"]) is not None]
    cells = (
        f"{stiffness:g}", f"{protocol.scene.board_friction:g}", f"{sum(s.c3_success for s in scores)} of {len(seeds)}",
        spread([s.c1_peak_force_n for s in scores]), spread(moved), spread(bends),
    )  # fmt: skip
    return f"| {' | '.join(cells)} |"


def spread(values: Sequence[float]) -> str:
    return f"{np.median(values):.1f} ({min(values):.1f} to {max(values):.1f})"


def pushed(protocol: Protocol, seed: int, stiffness: float) -> tuple[TrialScore, float]:
    """Return the score of a push, and the largest angle [deg] by which flexion or deviation of the wrist changed."""
    spec = TrialSpec(protocol=protocol, task_id=TASK, seed=seed, policy=POLICY)
    recording = run_trial(spec, prepare=partial(prepared, share=stiffness / SHOULDER_NM_RAD))
    names = list(recording.header.human_joints)
    wrist = [names.index(f"right_hand_{way}") for way in ("flexion", "deviation")]
    angle = recording["scorer/human_joint_position"][:, wrist]
    return score_recording(recording), float(np.degrees(np.abs(angle - angle[0]).max()))


def prepared(spec: TrialSpec, *, share: float) -> World:
    """Return the trial's world; the shoulder gets this share of its stiffness at rest, and damping as shipped."""
    world = settled_world(spec.protocol, task_id=spec.task_id, seed=spec.seed, salt=spec.salt)
    model = world[0].model
    for way in ("abduction", "flexion", "rotation"):
        model.jnt_stiffness[model.joint(f"human_right_upper_arm_{way}").id] *= share
    return world


if __name__ == "__main__":
    main()

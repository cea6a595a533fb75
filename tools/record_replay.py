"""Export the actions of a run as a donor file, which the blind baselines ``replay`` and ``replay-registered`` repeat.

    python tools/record_replay.py runs/replay-source
    python tools/record_replay.py runs/oracle-L2 --seed 3 --out donor.npz
    carecontact run --policy replay-registered --policy-arg donor=donor.npz --out runs/blind

The run has every task, with a seed on which the baselines will not be judged. The shipped file is the state machine's,
with a seed that no shipped protocol has:

    sed -e 's/^seeds = .*/seeds = [9999]/; 0,/^id/s/^id = .*/id = "replay-source"/; s/^frozen = .*/frozen = false/' \\
        src/carecontact/protocol/bathing-v3.toml > /tmp/replay.toml
    carecontact run --policy state-machine --protocol /tmp/replay.toml --out runs/replay-source
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

from carecontact.interface.geometry import matrix_from_quat, pose_matrix
from carecontact.interface.policy import CAMERAS
from carecontact.policies import replay
from carecontact.protocol.load import load_levels, shipped_protocols
from carecontact.recording import read_recording
from carecontact.recording.schema import Recording
from carecontact.world.scene import look_at

CAMERA = "overhead"
FROM_OPENCV = np.diag([1.0, -1.0, -1.0])
"""From OpenCV's axes of a camera to MuJoCo's."""
BELIEVED = "policy/believed_pose_camera_in_base"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path, help="folder of recordings")
    parser.add_argument("--seed", type=int, help="of the donor, where the run has several")
    parser.add_argument("--out", type=Path, help="default: the shipped file")
    given = parser.parse_args()
    shipped = Path(replay.__file__).parent / "data" / "replay" / replay.ACTIONS
    # A policy that repeats a trial must not be judged on that very trial.
    every = [] if given.out else [rules for name in shipped_protocols() for rules in load_levels(name).values()]
    taken = {seed for rules in every for seed in rules.randomization.seeds}
    arrays: dict[str, np.ndarray] = {}
    source: dict[str, object] = {}
    for path in sorted(given.run.glob("*.h5")):
        recording = read_recording(path)
        spec, card = recording.header.spec, recording.header.card
        if given.seed not in (None, spec.seed):
            continue
        if spec.seed in taken:
            parser.error(f"{path}: seed {spec.seed} belongs to a shipped protocol; its own trial would be replayed")
        if source.get("seed", spec.seed) != spec.seed:
            parser.error(f"{path}: a second seed, {spec.seed}; name one with --seed")
        if card is None or card["control_hz"] != replay.CONTROL_HZ or card["action_space"] != "cartesian_pose":
            parser.error(f"{path}: expected poses of the tool at {replay.CONTROL_HZ:g} Hz")
        prompt = spec.protocol.task(spec.task_id).prompt
        arrays[prompt], arrays[prompt + replay.CAMERA_ARRAY] = rows_of(recording), camera_in_base(recording)
        source |= {"policy": spec.policy, "protocol": spec.protocol.title, "protocol_sha256": spec.protocol.sha256}
        source["seed"] = spec.seed
    if not arrays:
        parser.error(f"{given.run}: no recording" + ("" if given.seed is None else f" of seed {given.seed}"))
    out = given.out or shipped
    np.savez_compressed(out, **arrays)  # pyright: ignore[reportArgumentType]
    text = json.dumps({"made by": "tools/record_replay.py", "licence": "Apache-2.0", **source}, indent=1)
    out.with_suffix(".provenance.json").write_text(text + "\n")
    print(f"{len(arrays) // 2} tasks, {out.stat().st_size / 1000:.0f} kB: {out}")


def rows_of(recording: Recording) -> np.ndarray:
    """(n, 9) as ``donor.ACTIONS`` has them."""
    stiffness = recording["actions/stiffness"].copy()
    # In force at each action; a row says only what changes.
    stiffness[1:][(np.diff(stiffness, axis=0) == 0).all(1)] = np.nan
    return np.concatenate([recording["actions/pose_tcp_in_base"], stiffness], axis=1).astype("<f4")


def camera_in_base(recording: Recording) -> np.ndarray:
    """(4, 4) of the overhead camera as the policy knew it, or else as the protocol has it."""
    if BELIEVED in recording.arrays:
        known = recording[BELIEVED][0, CAMERAS.index(CAMERA)]
        if np.isfinite(known).all():
            return pose_matrix(known[:3], known[3:])
    camera = recording.header.spec.protocol.cameras[CAMERA]
    base = pose_matrix(*np.split(np.array(recording.header.pose_base_in_world), [3]))
    in_world = np.eye(4)
    in_world[:3, :3], in_world[:3, 3] = matrix_from_quat(look_at(camera)) @ FROM_OPENCV, camera.position_m
    return np.linalg.inv(base) @ in_world


if __name__ == "__main__":
    main()

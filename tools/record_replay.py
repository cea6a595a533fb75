"""Write the actions of the null arm ``replay`` from a run's recordings.

    python tools/record_replay.py runs/replay-source

The run is the state machine's, every task once, with a seed that no shipped protocol has:

    sed -e 's/^seeds = .*/seeds = [1000]/; s/^id = .*/id = "replay-source"/; s/^frozen = .*/frozen = false/' \\
        src/carecontact/protocols/bathing-draft.toml > /tmp/replay.toml
    carecontact run --policy state-machine --protocol /tmp/replay.toml --out runs/replay-source
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

from carecontact.policies.replay import policy
from carecontact.protocols import load_protocol, shipped_protocols
from carecontact.recording import read_recording


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path, help="folder of recordings")
    arguments = parser.parse_args()
    taken = {seed for name in shipped_protocols() for seed in load_protocol(name).randomization.seeds}
    actions: dict[str, np.ndarray] = {}
    source: dict[str, object] = {}
    for path in sorted(arguments.run.glob("*.h5")):
        recording = read_recording(path)
        spec, card = recording.header.spec, recording.header.card
        if spec.seed in taken:
            parser.error(f"{path}: seed {spec.seed} belongs to a shipped protocol; its own trial would be replayed")
        if card is None or card["control_hz"] != policy.CONTROL_HZ:
            parser.error(f"{path}: expected actions at {policy.CONTROL_HZ:g} Hz")
        stiffness = recording["actions/stiffness"].copy()
        # In force at each action; a row says only what changes.
        stiffness[1:][(np.diff(stiffness, axis=0) == 0).all(1)] = np.nan
        rows = np.concatenate([recording["actions/pose_tcp_in_base"], stiffness], axis=1)
        actions[spec.protocol.task(spec.task_id).prompt] = rows.astype("<f4")
        source |= {"policy": spec.policy, "protocol_sha256": spec.protocol.sha256, "seed": spec.seed}
    folder = Path(policy.__file__).parent
    np.savez_compressed(folder / policy.ACTIONS, **actions)  # pyright: ignore[reportArgumentType]
    text = json.dumps({"made by": "tools/record_replay.py", "licence": "Apache-2.0", **source}, indent=1)
    (folder / "actions.provenance.json").write_text(text + "\n")
    print(f"{len(actions)} tasks, {(folder / policy.ACTIONS).stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()

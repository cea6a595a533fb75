"""Read a dataset with lerobot's own loader and write what it gives, for the test beside this file.

python read_lerobot.py DATASET OUT.npz        # in an environment that has lerobot
"""

from __future__ import annotations

import sys

import numpy as np
from lerobot.datasets.lerobot_dataset import LeRobotDataset


def main(folder: str, out: str) -> None:
    dataset = LeRobotDataset("local/dataset", root=folder)
    rows = [dataset[k] for k in range(len(dataset))]
    arrays = {key: np.stack([np.asarray(row[key]) for row in rows]) for key in rows[0] if key != "task"}
    np.savez(
        out, episodes=dataset.num_episodes, fps=dataset.fps, task=np.array([row["task"] for row in rows]),
        mean_action=dataset.meta.stats["action"]["mean"], **arrays,
    )  # fmt: skip


main(*sys.argv[1:])

"""Read a dataset with lerobot's own loader, take it apart with lerobot's own tools, and write what they give, for the
test beside this file.

python read_lerobot.py DATASET OUT.npz        # in an environment that has lerobot
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from lerobot.datasets.dataset_tools import delete_episodes, merge_datasets, split_dataset
from lerobot.datasets.lerobot_dataset import LeRobotDataset


def main(folder: str, out: str) -> None:
    dataset = LeRobotDataset("local/dataset", root=folder)
    rows = [dataset[k] for k in range(len(dataset))]
    arrays = {key: np.stack([np.asarray(row[key]) for row in rows]) for key in rows[0] if key != "task"}
    parts = Path(folder).with_name("parts")
    one = delete_episodes(dataset, episode_indices=[0], output_dir=parts / "rest", repo_id="local/rest")
    halves = split_dataset(dataset, splits={"first": [0], "second": [1]}, output_dir=parts)
    whole = merge_datasets(list(halves.values()), output_repo_id="local/merged", output_dir=parts / "merged")
    for name, part in (("deleted", one), ("merged", whole), *halves.items()):
        # Opened again: the tools keep statistics in memory that they may not have written.
        stats = LeRobotDataset(f"local/{name}", root=part.root).meta.stats or {}
        arrays |= {f"{name}/{key}/{each}": value for key, found in stats.items() for each, value in found.items()}
    np.savez(
        out, episodes=dataset.num_episodes, fps=dataset.fps, task=np.array([row["task"] for row in rows]), **arrays
    )


main(*sys.argv[1:])

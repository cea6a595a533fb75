"""A picture of the people of a protocol with levels: one column for each seed, one row for each level, from overhead.

python tools/gallery.py --out gallery.png [--protocol bathing-wide-v1] [--task T1] [--seeds 0-8]
"""

from __future__ import annotations

import argparse
from pathlib import Path

import cv2
import numpy as np

from carecontact.episode.prepare import settled_world
from carecontact.protocols import load_levels
from carecontact.runs.plan import parse_seeds
from carecontact.sim.rendering import SceneRenderer

WIDTH = 300
"""Of one picture [px]."""
LABEL = 18
"""Height of the line over it [px]."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--protocol", default="bathing-wide-v1")
    parser.add_argument("--task", default="T1")
    parser.add_argument("--seeds", default="0-8")
    parser.add_argument("--camera", default="overhead")
    parser.add_argument("--out", type=Path, required=True)
    given = parser.parse_args()
    rows: list[np.ndarray] = []
    for level, rules in load_levels(given.protocol).items():
        tiles: list[np.ndarray] = []
        for seed in parse_seeds(given.seeds, protocol=rules):
            simulation, _, _ = settled_world(rules, task_id=given.task, seed=seed)
            simulation.refresh()
            with SceneRenderer(simulation.model, protocol=simulation.protocol) as renderer:
                image = renderer.rgb(simulation.data, given.camera)
            tiles.append(tile(image, f"{level} seed {seed} {simulation.scene.body.name}"))
        rows.append(np.hstack(tiles))
    given.out.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(given.out), np.vstack(rows)[..., ::-1])


def tile(image: np.ndarray, label: str) -> np.ndarray:
    """(H, W, 3) the picture at WIDTH under its label."""
    height = round(WIDTH * image.shape[0] / image.shape[1])
    small = cv2.resize(image, (WIDTH, height), interpolation=cv2.INTER_AREA)
    line = np.full((LABEL, WIDTH, 3), 255, np.uint8)
    cv2.putText(line, label, (4, LABEL - 5), cv2.FONT_HERSHEY_SIMPLEX, 0.4, (30, 30, 30), 1, cv2.LINE_AA)
    return np.vstack([line, small])


if __name__ == "__main__":
    main()

"""A picture of the people of a protocol with levels: one column for each seed, and one row for each level, from
overhead. A last row shows each right arm of the last level from the head, low over the arm board.

python tools/gallery.py --out gallery.png [--protocol bathing-wide-v2] [--task T1] [--seeds 0-8]
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from carecontact.episode.randomization import settled_world
from carecontact.pictures import shrunk
from carecontact.protocol.load import load_levels
from carecontact.runs.plan import parse_seeds
from carecontact.sim.rendering import SceneRenderer
from carecontact.sim.simulation import Simulation

WIDTH, HEIGHT = 240, 240
"""Of one picture [px]."""
LABEL = 18
"""Height of the line over it [px]."""
CROP = 0.75
"""Of the width of an overhead picture, from the left: robot, arm board and bed are there, and the floor beyond."""


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--protocol", default="bathing-wide-v2")
    parser.add_argument("--task", default="T1")
    parser.add_argument("--seeds", default="0-8")
    parser.add_argument("--out", type=Path, required=True)
    given = parser.parse_args(arguments)
    rows: list[np.ndarray] = []
    arms: list[np.ndarray] = []
    for level, rules in load_levels(given.protocol).items():
        tiles: list[np.ndarray] = []
        arms.clear()
        for seed in parse_seeds(given.seeds, protocol=rules):
            simulation, _, _ = settled_world(rules, task_id=given.task, seed=seed)
            simulation.refresh()
            label = f"{level} seed {seed} {simulation.scene.body.name}".lstrip()
            above, arm = pictures(simulation)
            tiles.append(tile(above, label))
            arms.append(tile(arm, f"{label}: arm"))
        rows.append(np.hstack(tiles))
    rows.append(np.hstack(arms))
    given.out.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.vstack(rows)).save(given.out, quality=80)


def pictures(simulation: Simulation) -> tuple[np.ndarray, np.ndarray]:
    """Two pictures (H, W, 3): the cell from the overhead camera, and the right arm from the person's head."""
    data = simulation.data
    with SceneRenderer(simulation.model, protocol=simulation.protocol) as renderer:
        above = renderer.rgb(data, "overhead")
        arm = renderer.free_view(
            data, look_at=data.site("region_forearm").xpos, distance_m=0.7, azimuth_deg=180.0, elevation_deg=-4.0,
            size_of="overhead",
        )  # fmt: skip
    height, width = arm.shape[:2]
    return above[:, : round(CROP * width)], arm[:, (width - height) // 2 : (width + height) // 2]


def tile(image: np.ndarray, label: str) -> np.ndarray:
    """(HEIGHT + LABEL, WIDTH, 3) the picture under its label."""
    line = Image.new("RGB", (WIDTH, LABEL), "white")
    ImageDraw.Draw(line).text((4, LABEL - 5), label, fill=(30, 30, 30), font_size=11, anchor="ls")
    return np.vstack([np.array(line), shrunk(image, WIDTH)])


if __name__ == "__main__":
    main()

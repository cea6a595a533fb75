"""Make the paths that tests compare our planner with, by the planner of VoxPoser's release.

    python tools/release_paths.py CHECKOUT

CHECKOUT: huangwl18/VoxPoser at commit e3a4c9e (MIT licence). Reads the cases of
tests/policies/voxposer/release_paths.json, plans each with src/planners.py of the checkout and its own configuration,
and writes the file again with these waypoints. Nothing of the release is imported but its planner; what its
interfaces.py 380-399 does to the avoidance map before is done here.
"""

from __future__ import annotations

import contextlib
import io
import json
import re
import sys
import types
from pathlib import Path
from typing import Any

import numpy as np
from scipy.ndimage import distance_transform_edt

from carecontact.errors import CarecontactError, ConfigError

CASES = Path(__file__).resolve().parents[1] / "tests/policies/voxposer/release_paths.json"
SIZE = 100
TARGET_FREE, START_FREE = 15, 10
DRAWING = ("plotly", "plotly.graph_objects", "transforms3d", "transforms3d.quaternions")
"""Packages that the release's utils.py imports and its planner never uses."""


class Settings(dict[str, Any]):
    """The release reads its configuration both as items and as attributes."""

    __getattr__ = dict.__getitem__


def release_planner(checkout: Path) -> Any:
    """Raises ConfigError for a folder that is no checkout of the release."""
    source, configuration = checkout / "src", checkout / "src/configs/rlbench_config.yaml"
    for needed in (source / "planners.py", configuration):
        if not needed.is_file():
            raise ConfigError(f"{needed}: no such file; give a checkout of github.com/huangwl18/VoxPoser")
    for name in DRAWING:
        sys.modules.setdefault(name, types.ModuleType(name))
    sys.modules["transforms3d.quaternions"].__dict__.setdefault("mat2quat", None)
    sys.path.insert(0, str(source))
    from planners import PathPlanner  # pyright: ignore

    return PathPlanner(_planner_settings(configuration.read_text()), map_size=SIZE)  # pyright: ignore


def _planner_settings(text: str) -> Settings:
    """Of the block ``planner``: flat, numbers but for one word."""
    block = re.search(r"^planner:\n((?:  .+\n)+)", text, re.MULTILINE)
    if block is None:
        raise ConfigError("rlbench_config.yaml has no block planner: another version of the release?")
    pairs = (line.split(":", 1) for line in block[1].splitlines())
    return Settings({key.strip(): _number(value.strip()) for key, value in pairs})


def _number(text: str) -> Any:
    try:
        return float(text) if "." in text else int(text)
    except ValueError:
        return text


def waypoints(planner: Any, case: dict[str, Any]) -> list[list[float]]:
    """(n, 3) voxels, the start left out."""
    target, avoided, scene = (np.zeros((SIZE,) * 3) for _ in range(3))
    for voxel in case["targets"]:
        target[tuple(voxel)] = 1
    for low, high, value in case["avoided"]:
        avoided[tuple(map(slice, low, high))] = value
    for low, high in case["occupied"]:
        scene[tuple(map(slice, low, high))] = 1
    scene[distance_transform_edt(target == 0) < TARGET_FREE] = 0
    start = np.array(case["start"])
    # Near the border the index is negative and nothing is freed: so it is there.
    scene[tuple(slice(s - START_FREE, s + START_FREE) for s in start.tolist())] = 0
    with contextlib.redirect_stdout(io.StringIO()):
        path, _ = planner.optimize(start, target, np.clip(avoided + scene, 0, 1))
    return [[round(float(v), 3) for v in point] for point in path[1:]]


def main() -> int:
    if len(sys.argv) != 2:
        print(__doc__)
        return 2
    kept = json.loads(CASES.read_text())
    try:
        planner = release_planner(Path(sys.argv[1]))
    except CarecontactError as error:
        print(error, file=sys.stderr)
        return 2
    for case in kept["cases"]:
        made = waypoints(planner, case)
        apart = np.abs(np.subtract(made, case["waypoints"])).max() if len(made) == len(case["waypoints"]) else np.inf
        print(f"{case['name']}: {len(made)} waypoints, at most {apart:.4f} voxels from those that were kept")
        case["waypoints"] = made
    rows = ",\n  ".join(json.dumps(case) for case in kept["cases"])
    CASES.write_text(f'{{\n "source": {json.dumps(kept["source"])},\n "cases": [\n  {rows}\n ]\n}}\n')
    return 0


if __name__ == "__main__":
    sys.exit(main())

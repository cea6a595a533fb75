"""Render pictures of docs/figures: the four cameras at rest.

MUJOCO_GL=egl python tools/make_pictures.py docs/figures
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from carecontact.pictures import jpeg
from carecontact.protocol.load import load_protocol
from carecontact.sim.rendering import SceneRenderer
from carecontact.sim.simulation import Simulation
from carecontact.world.scene import build_scene


def save(path: Path, rgb: np.ndarray) -> None:
    path.write_bytes(jpeg(rgb, 88))
    print(f"{path}  {rgb.shape[1]}x{rgb.shape[0]}  {path.stat().st_size / 1000:.0f} kB")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    folder = parser.parse_args().folder
    folder.mkdir(parents=True, exist_ok=True)
    protocol = load_protocol()
    scene = build_scene(protocol, target="forearm")
    simulation = Simulation(scene)
    simulation.settle(52.5)
    simulation.start()
    with SceneRenderer(scene.model, protocol=protocol) as renderer:
        for camera in protocol.cameras:
            save(folder / f"camera_{camera}.jpg", renderer.rgb(simulation.data, camera))


if __name__ == "__main__":
    main()

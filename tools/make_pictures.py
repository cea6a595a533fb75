"""Render the pictures of docs/figures: the four cameras at rest, and the tool pressing into the forearm.

MUJOCO_GL=egl python tools/make_pictures.py docs/figures
"""

from __future__ import annotations

import argparse
from pathlib import Path

import cv2
import numpy as np

from carecontact.contract.geometry import matrix_from_quat
from carecontact.protocols import load_protocol
from carecontact.recording.schema import SEGMENTS
from carecontact.sim.close_up import dent
from carecontact.sim.rendering import SceneRenderer
from carecontact.sim.simulation import Simulation
from carecontact.world.scene import build_scene

DOWN = np.array([0.0, 1.0, 0.0, 0.0])
PRESS_DEPTH_M = 0.060


def save(path: Path, rgb: np.ndarray) -> None:
    cv2.imwrite(str(path), rgb[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 88])
    print(f"{path}  {rgb.shape[1]}x{rgb.shape[0]}  {path.stat().st_size / 1000:.0f} kB")


def move_to(simulation: Simulation, position_in_world: np.ndarray, seconds: float) -> None:
    base = simulation.pose_base_in_world
    position = matrix_from_quat(base[3:]).T @ (position_in_world - base[:3])
    simulation.set_goal(np.r_[position, DOWN], seconds)
    simulation.advance(round(seconds / simulation.model.opt.timestep))


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
        region = scene.regions["forearm"]
        ids = [scene.model.body(f"forearm_v{k}").id for k in region.vertex_index]
        points, middle = simulation.data.xpos[ids], simulation.data.site("region_forearm").xpos
        near = points[np.linalg.norm(points[:, :2] - middle[:2], axis=1) < 0.015]
        top = np.array([middle[0], middle[1], near[:, 2].max()])
        move_to(simulation, top + [0, 0, 0.12], 4.0)
        move_to(simulation, top - [0, 0, PRESS_DEPTH_M], 3.0)
        force = simulation.advance(1000)[-1].force[-1, SEGMENTS.index("right_forearm")]
        print(f"force {np.linalg.norm(force):.1f} N, indentation {simulation.indentation()[0] * 1000:.1f} mm")
        picture = renderer.free_view(
            simulation.data, look_at=simulation.data.site("tcp").xpos + [0, 0, 0.015],
            distance_m=0.25, azimuth_deg=60, elevation_deg=-17, size_of="overhead",
            edit=lambda made: dent(scene, simulation.data, made),
        )  # fmt: skip
        save(folder / "contact.jpg", picture)


if __name__ == "__main__":
    main()

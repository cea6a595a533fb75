"""Bake the Franka Panda description into one small numpy archive.

Needs packages that the product does not: ``pip install example-robot-data==6.0.0 trimesh pycollada
fast-simplification scipy shapely networkx``.

    python tools/bake_panda.py src/carecontact/assets/panda

Source: franka_description (franka_ros, Apache-2.0) as packaged by example-robot-data. Kept: joint frames, limits and
inertials of the URDF; visual meshes, welded, decimated and merged by colour; convex hulls of the distal links.
"""

from __future__ import annotations

import argparse
import hashlib
import importlib.metadata
import json
import shutil
import xml.etree.ElementTree as ET
from pathlib import Path

import fast_simplification
import numpy as np
import trimesh

PACKAGE = "example-robot-data"
LINKS = [*(f"link{i}" for i in range(8)), "hand"]
VISUAL_LINKS = [*LINKS, "finger"]
FACE_BUDGET = {"finger": 200, "hand": 1300, "link5": 1700, "link6": 1700}
DEFAULT_FACE_BUDGET = 1500
FINGER_CUT_M = 0.044
"""Fingers are cut at this height over their carriage: the rest is inside the silicone cap."""
FINGER_ORIGIN_Z_M = 0.0584
FINGER_MASS_KG = 0.015
CAP_MASS_KG = 0.020
CAP_CENTRE_Z_M = 0.105
"""The cap's mass is an assumption; fingers' mass is the URDF's. Both are lumped into the hand."""
COLLISION_PIECES = {"link5": -0.13, "link6": None, "link7": None, "hand": None}
"""Link -> height at which its mesh is cut in two before the hulls are taken (the forearm's hull alone is too fat)."""


def colour_group(rgba: np.ndarray) -> str:
    """The DAE's materials are two whites, a dark grey, a blue mark and two pin-head lamps."""
    r, g, b = (int(c) for c in rgba[:3])
    if min(r, g, b) > 250:
        return "white"
    if min(r, g, b) > 200:
        return "grey"
    return "blue" if b > 150 and r < 100 else "dark"


def visual_groups(path: Path) -> dict[str, trimesh.Trimesh]:
    scene = trimesh.load(path)
    parts: dict[str, list[trimesh.Trimesh]] = {}
    for node in scene.graph.nodes_geometry:
        transform, name = scene.graph[node]
        geometry = scene.geometry[name]
        colour = colour_group(np.asarray(geometry.visual.material.main_color))
        mesh = trimesh.Trimesh(geometry.vertices, geometry.faces, process=False).apply_transform(transform)
        parts.setdefault(colour, []).append(mesh)
    merged = {}
    for colour, meshes in parts.items():
        mesh = trimesh.util.concatenate(meshes)
        mesh.merge_vertices(merge_norm=True, merge_tex=True, digits_vertex=5)
        mesh.update_faces(mesh.nondegenerate_faces())
        merged[colour] = mesh
    return merged


def decimated(mesh: trimesh.Trimesh, faces: int) -> tuple[np.ndarray, np.ndarray]:
    vertices, triangles = np.asarray(mesh.vertices, np.float32), np.asarray(mesh.faces, np.int32)
    if len(triangles) > faces:
        vertices, triangles = fast_simplification.simplify(vertices, triangles, target_count=faces)
    used, inverse = np.unique(triangles, return_inverse=True)
    return np.asarray(vertices, np.float32)[used], inverse.reshape(-1, 3).astype(np.uint16)


def hull_pieces(path: Path, cut_z: float | None) -> list[tuple[np.ndarray, np.ndarray]]:
    mesh = trimesh.load(path)
    pieces = [mesh]
    if cut_z is not None:
        pieces = [mesh.slice_plane([0, 0, cut_z], [0, 0, sign]) for sign in (1.0, -1.0)]
    hulls = [piece.convex_hull for piece in pieces]
    return [(np.asarray(h.vertices, np.float32), np.asarray(h.faces, np.uint16)) for h in hulls]


def numbers(text: str) -> np.ndarray:
    return np.array([float(x) for x in text.split()])


def quat_of_rpy(rpy: np.ndarray) -> np.ndarray:
    r, p, y = rpy / 2
    qx, qy, qz = (np.array([np.cos(a), *(np.sin(a) * np.eye(3)[i])]) for i, a in enumerate((r, p, y)))
    return trimesh.transformations.quaternion_multiply(qz, trimesh.transformations.quaternion_multiply(qy, qx))


def kinematics(urdf: ET.Element) -> dict[str, np.ndarray]:
    """Frames of link1..link7 and hand in their parent (the fixed flange frame folded in), limits and inertials."""
    joints = {j.get("name"): j for j in urdf.findall("joint")}

    def origin(name: str) -> tuple[np.ndarray, np.ndarray]:
        o = joints[name].find("origin")
        return numbers(o.get("xyz")), quat_of_rpy(numbers(o.get("rpy")))

    frames = [origin(f"panda_joint{i}") for i in range(1, 8)]
    flange, hand = origin("panda_joint8"), origin("panda_hand_joint")
    frames.append((flange[0] + hand[0], hand[1]))
    limits = [joints[f"panda_joint{i}"].find("limit") for i in range(1, 8)]
    masses, centres, inertias = [], [], []
    for name in LINKS:
        inertial = urdf.find(f"link[@name='panda_{name}']/inertial")
        i = inertial.find("inertia").attrib
        masses.append(float(inertial.find("mass").get("value")))
        centres.append(numbers(inertial.find("origin").get("xyz")))
        inertias.append([float(i[k]) for k in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")])
    masses[-1], centres[-1], inertias[-1] = lump_tool(masses[-1], centres[-1], np.array(inertias[-1]))
    return {
        "frame_position_m": np.array([f[0] for f in frames]),
        "frame_quat": np.array([f[1] for f in frames]),
        "joint_range_rad": np.array([[float(x.get("lower")), float(x.get("upper"))] for x in limits]),
        "joint_effort_nm": np.array([float(x.get("effort")) for x in limits]),
        "mass_kg": np.array(masses),
        "centre_of_mass_m": np.array(centres),
        "inertia_kgm2": np.array(inertias),
    }


def lump_tool(mass: float, centre: np.ndarray, inertia: np.ndarray) -> tuple[float, np.ndarray, list[float]]:
    """Add the closed fingers and the cap to the hand as point masses."""
    ixx, iyy, izz, ixy, ixz, iyz = inertia
    tensor = np.array([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]])
    points = np.array([[0, 0, FINGER_ORIGIN_Z_M + 0.027], [0, 0, CAP_CENTRE_Z_M]])
    point_masses = np.array([2 * FINGER_MASS_KG, CAP_MASS_KG])
    total = mass + point_masses.sum()
    new_centre = (mass * centre + point_masses @ points) / total
    for m, p in [(mass, centre), *zip(point_masses, points, strict=True)]:
        r = p - new_centre
        tensor = tensor + m * (r @ r * np.eye(3) - np.outer(r, r))
    return total, new_centre, [tensor[0, 0], tensor[1, 1], tensor[2, 2], tensor[0, 1], tensor[0, 2], tensor[1, 2]]


def bake(folder: Path) -> Path:
    distribution = importlib.metadata.distribution(PACKAGE)
    urdf_path = next(
        Path(distribution.locate_file(f)) for f in distribution.files or [] if str(f).endswith("urdf/panda.urdf")
    )
    source = urdf_path.parent.parent
    arrays: dict[str, np.ndarray] = kinematics(ET.parse(urdf_path).getroot())
    hashes = {"urdf/panda.urdf": hashlib.sha256(urdf_path.read_bytes()).hexdigest()}
    n_faces = 0
    for link in VISUAL_LINKS:
        path = source / "meshes/visual" / f"{link}.dae"
        hashes[f"meshes/visual/{link}.dae"] = hashlib.sha256(path.read_bytes()).hexdigest()
        groups = visual_groups(path)
        if link == "finger":
            groups = {c: m.slice_plane([0, 0, FINGER_CUT_M], [0, 0, -1.0]) for c, m in groups.items()}
            groups = {c: m for c, m in groups.items() if len(m.faces)}
        total = sum(len(m.faces) for m in groups.values())
        for colour, mesh in groups.items():
            share = max(30, round(FACE_BUDGET.get(link, DEFAULT_FACE_BUDGET) * len(mesh.faces) / total))
            vertices, faces = decimated(mesh, share)
            arrays[f"visual/{link}/{colour}/vertices"], arrays[f"visual/{link}/{colour}/faces"] = vertices, faces
            n_faces += len(faces)
    for link, cut_z in COLLISION_PIECES.items():
        path = source / "meshes/collision" / f"{link}.stl"
        hashes[f"meshes/collision/{link}.stl"] = hashlib.sha256(path.read_bytes()).hexdigest()
        for k, (vertices, faces) in enumerate(hull_pieces(path, cut_z)):
            arrays[f"collision/{link}/{k}/vertices"], arrays[f"collision/{link}/{k}/faces"] = vertices, faces
    folder.mkdir(parents=True, exist_ok=True)
    out = folder / "panda.npz"
    np.savez_compressed(out, **arrays)
    shutil.copyfile(source / "LICENSE", folder / "LICENSE")
    provenance = {
        "source": "franka_description of franka_ros, https://github.com/frankaemika/franka_ros",
        "licence": "Apache-2.0",
        "package": f"{PACKAGE} {distribution.version}",
        "script": "tools/bake_panda.py",
        "changes": "visual meshes welded, decimated and merged by colour; fingertips cut off under the cap; collision "
        "meshes replaced by convex hulls; fingers and cap lumped into the hand's inertial",
        "assumed": {"cap_mass_kg": CAP_MASS_KG},
        "visual_faces": n_faces,
        "source_sha256": hashes,
        "sha256": hashlib.sha256(out.read_bytes()).hexdigest(),
    }
    (folder / "panda.provenance.json").write_text(json.dumps(provenance, indent=2, sort_keys=True) + "\n")
    return out


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    written = bake(parser.parse_args().folder)
    print(f"{written}: {written.stat().st_size / 1e6:.2f} MB")

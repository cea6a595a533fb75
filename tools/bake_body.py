"""Bake one Anny body into a small numpy archive.

Needs packages that the product does not: ``pip install torch==2.13.0 anny==0.6.2``.
The first run builds a cache of about 800 MB in the home folder.

    python tools/bake_body.py man-adult src/carecontact/assets/bodies
    python tools/bake_body.py all src/carecontact/assets/bodies

A body baked on another machine can differ by the rounding of single precision sums (some 1e-7 m).

Source: Anny (Apache-2.0 code; MakeHuman / MPFB2 body data, CC0). The archive holds geometry only:
vertices, faces, texture coordinates, four skin weights a vertex over our segments, joint centres.
"""

from __future__ import annotations

import argparse
import hashlib
import importlib.metadata
import json
from pathlib import Path

import anny
import numpy as np
import torch
from anny.anthropometry import Anthropometry

# Segment -> the rig bones merged into it, the first being the one whose head is the segment's joint centre.
SEGMENT_BONES: dict[str, list[str]] = {
    "pelvis": ["root", "pelvis.L", "pelvis.R"],
    "abdomen": ["spine05", "spine04"],
    "thorax": ["spine03", "spine02", "spine01"],
    "neck": ["neck01", "neck02", "neck03"],
    "head": ["head", "eye.L", "eye.R"],
}
for _side, _name in (("L", "left"), ("R", "right")):
    SEGMENT_BONES |= {
        f"{_name}_clavicle": [f"clavicle.{_side}", f"shoulder01.{_side}"],
        f"{_name}_upper_arm": [f"upperarm01.{_side}", f"upperarm02.{_side}"],
        f"{_name}_forearm": [f"lowerarm01.{_side}", f"lowerarm02.{_side}"],
        f"{_name}_hand": [f"wrist.{_side}"],
        f"{_name}_thigh": [f"upperleg01.{_side}", f"upperleg02.{_side}"],
        f"{_name}_shank": [f"lowerleg01.{_side}", f"lowerleg02.{_side}"],
        f"{_name}_foot": [f"foot.{_side}"],
    }

# Anny: gender 0 man, 1 woman; age 0.67 young adult, 1 old. Stature is met by bisecting its height parameter, body mass
# index by bisecting its weight parameter. Statures: of the order of European and US means (assumed), less 4 and 5 cm
# for the old (Sorkin, Muller, Andres 1999, Am J Epidemiol 150:969: men and women lose 3 and 5 cm from 30 to 70 years, 5
# and 8 cm to 80). Body mass index: 20.5 and 32 lie in the classes "normal" (18.5 to 25) and "obese I" (30 to 35) of WHO
# Technical Report 894 (2000). Muscle is assumed: heavy bodies have less, or Anny could make no woman of that mass.
STATURE_M = {("man", "adult"): 1.75, ("woman", "adult"): 1.62, ("man", "old"): 1.71, ("woman", "old"): 1.57}
BMI = {"light": 20.5, "heavy": 32.0}
MUSCLE = {("man", "light"): 0.4, ("woman", "light"): 0.4, ("man", "heavy"): 0.15, ("woman", "heavy"): 0.0}
ARMS_RAISED_DEG = {"light": 12.0, "heavy": 26.0}
BODIES: dict[str, dict] = {
    "man-adult": {"stature_m": 1.75, "sex": "M", "age": "adult",
                  "phenotype": {"gender": 0.0, "age": 0.67, "weight": 0.55, "muscle": 0.5}},
    **{
        f"{who}-{age}-{build}": {
            "stature_m": STATURE_M[who, age], "bmi": BMI[build], "arms_raised_deg": ARMS_RAISED_DEG[build],
            "sex": "M" if who == "man" else "F", "age": age,
            "phenotype": {"gender": float(who == "woman"), "age": 0.67 if age == "adult" else 1.0,
                          "muscle": MUSCLE[who, build]},
        }
        for who in ("man", "woman") for age in ("adult", "old") for build in ("light", "heavy")
    },
}  # fmt: skip

LANDMARK_BONES = (
    "eye.L", "eye.R", "head", *(f"{bone}.{side}" for side in "LR" for bone in ("finger3-3", "finger2-1", "finger5-1")),
)  # fmt: skip

# The rig's arms hang at 41 degrees; at the lying arm's 45 to 60 a heavy body's armpit is open and its upper arm a tube.
# "arms_raised_deg" turns them there. The lying arm is nearly straight and its palm faces up. Turning the rig's two
# forearm bones before baking spreads the twist along the forearm; turning one rigid forearm by as much later would
# wring the skin at the elbow.
ELBOW_UNBEND_DEG = 30.0
TWIST_DEG = {"lowerarm01": 18.0, "lowerarm02": 36.0}


def stature_of(output: dict) -> float:
    z = output["rest_vertices"][0, :, 2]
    return float(z.max() - z.min())


def shaped(model: anny.Anny, spec: dict) -> tuple[dict, dict[str, float]]:
    """Anny's output of a body with the wanted stature (and body mass index, where one is named), and its parameters."""

    def with_stature(phenotype: dict[str, float]) -> tuple[dict, float]:
        low, high = 0.0, 1.0
        for _ in range(25):
            height = (low + high) / 2
            output = model(phenotype_kwargs={"height": height, **phenotype})
            low, high = (height, high) if stature_of(output) < spec["stature_m"] else (low, height)
        return output, height

    phenotype, measure = dict(spec["phenotype"]), Anthropometry(model)
    if "bmi" in spec:
        low, high = 0.0, 1.0
        for _ in range(12):
            phenotype["weight"] = round((low + high) / 2, 4)
            output, height = with_stature(phenotype)
            got = float(measure(output["rest_vertices"])["mass"]) / stature_of(output) ** 2
            low, high = (phenotype["weight"], high) if got < spec["bmi"] else (low, phenotype["weight"])
        if abs(got - spec["bmi"]) > 0.1:
            raise SystemExit(f"Anny makes no body mass index of {spec['bmi']} with {phenotype}: nearest {got:.1f}")
    output, height = with_stature(phenotype)
    return output, {**phenotype, "height": height}


def rotation(axis: np.ndarray, degrees: float) -> np.ndarray:
    x, y, z = axis / np.linalg.norm(axis)
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    angle = np.radians(degrees)
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * (k @ k)


def arm_transforms(labels: list[str], parents: list[int], heads: np.ndarray, raised_deg: float) -> np.ndarray:
    """(bones, 4, 4) in model space: upper arms raised, forearm bones turned, everything beyond them carried along."""
    local = {}
    for side, sign in (("L", -1.0), ("R", 1.0)):
        at = {bone: heads[labels.index(f"{bone}.{side}")] for bone in ("upperarm01", "lowerarm01", "wrist")}
        upper, fore = at["lowerarm01"] - at["upperarm01"], at["wrist"] - at["lowerarm01"]
        unbend = rotation(np.cross(upper, fore), -ELBOW_UNBEND_DEG)
        if raised_deg:
            local[f"upperarm01.{side}"] = rotation(np.array([0.0, sign, 0.0]), raised_deg)
        local[f"lowerarm01.{side}"] = unbend @ rotation(fore, sign * TWIST_DEG["lowerarm01"])
        local[f"lowerarm02.{side}"] = rotation(fore, sign * TWIST_DEG["lowerarm02"])
    out = np.tile(np.eye(4), (len(labels), 1, 1))
    for bone, label in enumerate(labels):  # parents come first
        own = np.eye(4)
        if label in local:
            own[:3, :3] = local[label]
            own[:3, 3] = heads[bone] - local[label] @ heads[bone]
        out[bone] = (out[parents[bone]] if parents[bone] >= 0 else np.eye(4)) @ own
    return out


def bake(name: str, folder: Path) -> Path:
    spec = BODIES[name]
    model = anny.Anny().to(dtype=torch.float32)
    output, phenotype = shaped(model, spec)
    height = phenotype.pop("height")
    labels, parents = list(model.bone_labels), list(model.bone_parents)
    heads = output["rest_bone_heads"][0].detach().numpy()
    bone_index, bone_weight = model.vertex_bone_indices.numpy(), model.vertex_bone_weights.numpy()
    transforms = arm_transforms(labels, parents, heads, spec.get("arms_raised_deg", 0.0))
    vertices = output["rest_vertices"][0].detach().numpy()
    moved = np.einsum("bij,vj->bvi", transforms[:, :3, :3], vertices) + transforms[:, None, :3, 3]
    vertices = np.einsum("vk,vki->vi", bone_weight, moved[bone_index, np.arange(len(vertices))[:, None]])
    heads = np.einsum("bij,bj->bi", transforms[:, :3, :3], heads) + transforms[:, :3, 3]
    segments = list(SEGMENT_BONES)

    owner = []  # rig bone -> segment index, walking up to the first bone that a segment names
    for bone in range(len(labels)):
        at = bone
        while (hit := next((s for s, bones in SEGMENT_BONES.items() if labels[at] in bones), None)) is None:
            at = parents[at]
        owner.append(segments.index(hit))
    weights = np.zeros((len(vertices), len(segments)), np.float32)
    for k in range(bone_index.shape[1]):
        np.add.at(weights, (np.arange(len(vertices)), np.array(owner)[bone_index[:, k]]), bone_weight[:, k])
    order = np.argsort(-weights, axis=1)[:, :4]
    top = np.take_along_axis(weights, order, 1)
    top /= top.sum(1, keepdims=True)

    is_eye = np.array(
        [labels[b].startswith("eye") for b in bone_index[np.arange(len(vertices)), bone_weight.argmax(1)]]
    )
    measured = {k: float(v) for k, v in Anthropometry(model)(output["rest_vertices"]).items()}
    provenance = {
        "source": "Anny",
        "package": f"anny {importlib.metadata.version('anny')}",
        "licence": "code Apache-2.0; MakeHuman / MPFB2 body data CC0",
        "script": "tools/bake_body.py",
        "parameters": {**spec, "phenotype": phenotype, "height": height},
        "measured_by_anny": measured,
    }
    arrays = {
        "vertices_m": vertices.astype(np.float32),
        "faces": model.faces.numpy().astype(np.uint16),
        "uv": model.texture_coordinates.numpy().astype(np.float32),
        "uv_faces": model.face_texture_coordinate_indices.numpy().astype(np.uint16),
        "segments": np.array(segments),
        "joint_centres_m": np.array([heads[labels.index(SEGMENT_BONES[s][0])] for s in segments], np.float32),
        "weight_segment": order.astype(np.uint8),
        "weight": np.round(top * 255).astype(np.uint8),
        "is_eye": is_eye,
        "landmark_names": np.array([b for b in LANDMARK_BONES if b in labels]),
        "landmarks_m": np.array([heads[labels.index(b)] for b in LANDMARK_BONES if b in labels], np.float32),
        "meta_json": np.frombuffer(json.dumps(provenance, sort_keys=True).encode(), np.uint8),
    }
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{name}.npz"
    np.savez_compressed(path, **arrays)
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    (folder / f"{name}.provenance.json").write_text(
        json.dumps({**provenance, "sha256": digest}, indent=2, sort_keys=True) + "\n"
    )
    print(
        f"{path}  {path.stat().st_size / 1e6:.2f} MB  stature {stature_of(output):.3f} m  "
        f"mass {measured['mass']:.1f} kg  BMI {measured['mass'] / stature_of(output) ** 2:.1f}  sha256 {digest[:12]}"
    )
    return path


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("name", choices=[*sorted(BODIES), "all"])
    parser.add_argument("folder", type=Path)
    arguments = parser.parse_args()
    for name in BODIES if arguments.name == "all" else [arguments.name]:
        bake(name, arguments.folder)

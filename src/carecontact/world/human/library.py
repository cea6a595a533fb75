"""Bodies by name: the shipped archives, made by ``tools/bake_body.py``, and a user's own SMPL-X file."""

from __future__ import annotations

import hashlib
import io
import json

import numpy as np

from carecontact.errors import AssetError, UnknownNameError
from carecontact.world.human.body import Body
from carecontact.world.human.smplx import SMPLX_PREFIX, load_smplx
from carecontact.world.human.stored import body_file, body_folder


def body_names() -> list[str]:
    """Names of the shipped bodies, sorted."""
    folder = body_folder()
    return sorted(p.name.removesuffix(".npz") for p in folder.iterdir() if p.name.endswith(".npz"))


def load_body(name: str) -> Body:
    """Load a shipped body by its name, or a user's own SMPL-X file as ``smplx:FILE.npz?sex=F``.

    Raises UnknownNameError for any other name, AssetError where a shipped archive has no provenance file or does not
    have the hash recorded there, and ConfigError for an SMPL-X file that cannot be used.
    """
    if name.startswith(SMPLX_PREFIX):
        return load_smplx(name)
    if name not in body_names():
        raise UnknownNameError("body", name, [*body_names(), f"{SMPLX_PREFIX}FILE.npz?sex=F (your own)"])
    data = body_file(f"{name}.npz")
    digest = hashlib.sha256(data).hexdigest()
    try:
        expected = json.loads(body_file(f"{name}.provenance.json"))["sha256"]
    except OSError as error:
        raise AssetError(f"body {name}: {error}; reinstall the package or run tools/bake_body.py") from None
    if digest != expected:
        raise AssetError(f"body {name}.npz has sha256 {digest[:12]}..., its provenance file says {expected[:12]}...")
    with np.load(io.BytesIO(data)) as z:
        arrays = {k: z[k] for k in z.files}
    segments = tuple(str(s) for s in arrays["segments"])
    weight = arrays["weight"].astype(np.float64)
    centres = dict(zip(segments, arrays["joint_centres_m"].astype(np.float64), strict=True))
    # The rig's root and its first spine bone share one point. The pelvis turns about the hips, the trunk about L5/S1.
    centres["pelvis"] = (centres["left_thigh"] + centres["right_thigh"]) / 2
    centres["abdomen"] = centres["pelvis"] + 0.25 * (centres["thorax"] - centres["pelvis"])
    meta = json.loads(arrays["meta_json"].tobytes())
    return Body(
        name=name,
        sex=meta["parameters"]["sex"],
        age_group=meta["parameters"]["age"],
        mass_kg=float(meta["measured_by_anny"]["mass"]),
        licence=meta["licence"],
        vertices=arrays["vertices_m"].astype(np.float64),
        faces=arrays["faces"].astype(np.int64),
        uv=arrays["uv"].astype(np.float64),
        uv_faces=arrays["uv_faces"].astype(np.int64),
        segments=segments,
        joint_centre=centres,
        weight_segment=arrays["weight_segment"].astype(np.int64),
        weight=weight / weight.sum(1, keepdims=True),
        is_eye=arrays["is_eye"],
        landmarks=dict(
            zip([str(n) for n in arrays["landmark_names"]], arrays["landmarks_m"].astype(np.float64), strict=True)
        ),
        meta=meta,
        sha256=digest,
    )

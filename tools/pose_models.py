"""Takes the two networks of MediaPipe Pose out of its published wheel: src/carecontact/assets/pose.

    python tools/pose_models.py

pip downloads the wheel of mediapipe 0.10.21 (35 MB) from the package index, and the script checks its hash. The files
are copied as they are.
"""

from __future__ import annotations

import hashlib
import json
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path

FOLDER = Path(__file__).resolve().parents[1] / "src" / "carecontact" / "assets" / "pose"
PACKAGE = "mediapipe==0.10.21"
WHEEL_SHA256 = "05dc4a9e593655a79558d05d6227d31018c2537a4bd3362b51e230cf22aecfe3"
"""Of mediapipe-0.10.21-cp311-cp311-manylinux_2_28_x86_64.whl."""
MODELS = {
    "pose_detection.tflite": "mediapipe/modules/pose_detection/pose_detection.tflite",
    "pose_landmark_full.tflite": "mediapipe/modules/pose_landmark/pose_landmark_full.tflite",
}


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run(
            [sys.executable, "-m", "pip", "download", "--quiet", "--no-deps", "--only-binary=:all:", "--dest", folder,
             "--python-version=3.11", "--platform=manylinux_2_28_x86_64", PACKAGE], check=True,
        )  # fmt: skip
        (path,) = Path(folder).glob("mediapipe-*.whl")
        if hashlib.sha256(path.read_bytes()).hexdigest() != WHEEL_SHA256:
            sys.exit(f"{path.name}: not the wheel that the script was written for")
        with zipfile.ZipFile(path) as wheel:
            licence = wheel.read("mediapipe-0.10.21.dist-info/LICENSE")
            found = {name: wheel.read(place) for name, place in MODELS.items()}
    FOLDER.mkdir(parents=True, exist_ok=True)
    (FOLDER / "LICENSE").write_bytes(licence)
    for name, model in found.items():
        (FOLDER / name).write_bytes(model)
        provenance = {
            "changes": "none",
            "licence": "Apache-2.0",
            "package": PACKAGE.replace("==", " "),
            "script": "tools/pose_models.py",
            "sha256": hashlib.sha256(model).hexdigest(),
            "source": f"{MODELS[name]}, https://github.com/google-ai-edge/mediapipe; Copyright The MediaPipe Authors",
            "wheel_sha256": WHEEL_SHA256,
        }
        written = (FOLDER / name).with_suffix(".provenance.json")
        written.write_text(json.dumps(provenance, indent=2, sort_keys=True) + "\n")


if __name__ == "__main__":
    main()

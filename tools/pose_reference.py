"""Records what MediaPipe Pose 0.10.21 answers for 40 pictures of people on the bed: tests/data/pose.npz.

    python tools/pose_reference.py        (in an environment with mediapipe 0.10.21 beside carecontact)

The pictures are stored as JPEG, and the answers are those for the decoded pictures. tests/sensing/test_blazepose.py
compares ``sensing.blazepose`` with them.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from mediapipe.python.solutions.pose import Pose  # pyright: ignore[reportMissingImports]

from carecontact.episode.episode import Episode
from carecontact.interface.policy import PolicyCard
from carecontact.pictures import decoded, jpeg, shrunk
from carecontact.protocol.load import load_protocol
from carecontact.runs.plan import plan_trials

TARGET = Path(__file__).resolve().parents[1] / "tests" / "data" / "pose.npz"
PICTURES, SEEDS, CAMERAS = 40, range(900, 914), ("overhead", "bedside", "exterior")
WIDTH, QUALITY = 480, 85


def main() -> None:
    protocol = load_protocol("bathing-wide-v2", level="L3")
    card = PolicyCard(name="pictures", modalities=("rgb",), cameras=CAMERAS)
    pose = Pose(static_image_mode=True, model_complexity=1, enable_segmentation=True, min_detection_confidence=0.5)
    jpegs, landmarks, masks = [], [], []
    for number, seed in enumerate(SEEDS):
        task = protocol.tasks[number % len(protocol.tasks)].id
        (spec,) = plan_trials(protocol=protocol, policy="zero-action", tasks=[task], seeds=[seed])
        with Episode(spec, card=card) as episode:
            seen = episode.reset()
        for turns, camera in enumerate(CAMERAS):
            picture = np.rot90(shrunk(seen.cameras[camera].rgb, WIDTH), turns * (number % 2))
            data = jpeg(picture, QUALITY)
            rgb = decoded(data)
            found = pose.process(rgb)
            marks = np.full((33, 3), np.nan, np.float32)
            mask = np.zeros(rgb.shape[:2], bool)
            if found.pose_landmarks is not None:
                marks[:] = [(mark.x, mark.y, mark.visibility) for mark in found.pose_landmarks.landmark]
                marks[:, :2] *= rgb.shape[1::-1]
                mask = found.segmentation_mask > 0.5
            jpegs.append(np.frombuffer(data, np.uint8))
            landmarks.append(marks)
            masks.append(np.packbits(mask))
    stored = {f"jpeg_{k}": jpeg for k, jpeg in enumerate(jpegs[:PICTURES])}
    np.savez_compressed(TARGET, landmarks=np.array(landmarks[:PICTURES]), masks=np.array(masks[:PICTURES]), **stored)
    print(f"{TARGET}: {TARGET.stat().st_size / 1e6:.2f} MB, {len(landmarks[:PICTURES])} pictures")


if __name__ == "__main__":
    main()

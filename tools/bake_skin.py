"""Paint a body's default skin texture at full detail and store it as a PNG beside the body.

    python tools/bake_skin.py man-adult src/carecontact/assets/bodies

Our own procedural paint on the body's own texture coordinates; nothing is taken from elsewhere.
"""

from __future__ import annotations

import argparse
import hashlib
import json
from pathlib import Path

import cv2

from carecontact.world.human.body import load_body
from carecontact.world.human.refine import refined
from carecontact.world.human.skin import Appearance, paint

# Splits of each face before painting, where an edge of cloth or a face's features cross it.
SPLITS = {"pelvis": 3, "abdomen": 3, "left_thigh": 3, "right_thigh": 3, "head": 1}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("name")
    parser.add_argument("folder", type=Path)
    arguments = parser.parse_args()
    body = load_body(arguments.name)
    fine = body
    for segment, times in SPLITS.items():
        fine = refined(fine, segment, times=times)
    image = paint(fine, Appearance())
    path = arguments.folder / f"{arguments.name}.skin.png"
    cv2.imwrite(str(path), cv2.cvtColor(image, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_PNG_COMPRESSION, 9])
    record = {
        "source": "procedural paint of this project", "script": "tools/bake_skin.py", "licence": "Apache-2.0",
        "body_sha256": body.sha256, "sha256": hashlib.sha256(path.read_bytes()).hexdigest(),
    }  # fmt: skip
    path.with_suffix(".provenance.json").write_text(json.dumps(record, indent=2, sort_keys=True) + "\n")
    print(f"{path}  {path.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()

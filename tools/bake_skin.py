"""Paint a body's default skin texture at full detail and store it as a PNG beside the body.

    python tools/bake_skin.py man-adult src/carecontact/assets/bodies
    python tools/bake_skin.py all src/carecontact/assets/bodies

Our own procedural paint on the body's own texture coordinates; nothing is taken from elsewhere.
"""

from __future__ import annotations

import argparse
import hashlib
import json
from dataclasses import asdict
from pathlib import Path

from PIL import Image

from carecontact.human.library import body_names, load_body
from carecontact.human.skin import GREY, Appearance, fine_paint

LIGHT, BROWN, DARK, PINK = (214, 164, 134), (168, 118, 88), (116, 78, 58), (226, 178, 156)
WHITE = (206, 204, 200)
APPEARANCE = {
    "man-adult": Appearance(),
    "man-adult-light": Appearance(skin=BROWN, cloth=(72, 84, 60), hair=(28, 22, 20)),
    "man-adult-heavy": Appearance(skin=PINK, cloth=(60, 60, 68), hair=(112, 78, 46)),
    "man-old-light": Appearance(skin=(218, 172, 146), cloth=(84, 76, 96), hair=WHITE),
    "man-old-heavy": Appearance(skin=DARK, cloth=(96, 104, 118), hair=GREY),
    "woman-adult-light": Appearance(skin=DARK, cloth=(122, 48, 62), hair=(24, 18, 16)),
    "woman-adult-heavy": Appearance(skin=LIGHT, cloth=(40, 90, 96), hair=(84, 54, 32)),
    "woman-old-light": Appearance(skin=PINK, cloth=(66, 70, 110), hair=WHITE),
    "woman-old-heavy": Appearance(skin=BROWN, cloth=(92, 58, 92), hair=GREY),
}


def bake(name: str, folder: Path) -> None:
    body, appearance = load_body(name), APPEARANCE[name]
    image = fine_paint(body, appearance)
    path = folder / f"{name}.skin.png"
    Image.fromarray(image).save(path, optimize=True)
    record = {
        "source": "procedural paint of this project", "script": "tools/bake_skin.py", "licence": "Apache-2.0",
        "appearance": asdict(appearance), "body_sha256": body.sha256,
        "sha256": hashlib.sha256(path.read_bytes()).hexdigest(),
    }  # fmt: skip
    path.with_suffix(".provenance.json").write_text(json.dumps(record, indent=2, sort_keys=True) + "\n")
    print(f"{path}  {path.stat().st_size / 1e6:.2f} MB")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("name", choices=[*body_names(), "all"])
    parser.add_argument("folder", type=Path)
    arguments = parser.parse_args()
    for name in body_names() if arguments.name == "all" else [arguments.name]:
        bake(name, arguments.folder)


if __name__ == "__main__":
    main()

"""Make tests/data/openpi with the client of openpi itself, in an environment of its own: openpi-client 0.1.2, numpy 1.

    .venv/bin/python tools/make_openpi_fixtures.py

It needs the package index. The licence of what is made stands in tests/data/openpi/README.md.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "tests" / "data" / "openpi"
PACKAGES = ("openpi-client==0.1.2", "numpy<2", "pillow==13.0.0")
SCRIPT = """
import sys
from pathlib import Path
import numpy as np
from openpi_client import image_tools, msgpack_numpy

folder = Path(sys.argv[1])
sys.path.insert(0, sys.argv[2])
from tests.serving.fakes import SIZES, actions, metadata, picture, request

(folder / "request.bin").write_bytes(msgpack_numpy.packb(request()))
(folder / "metadata.bin").write_bytes(msgpack_numpy.packb(metadata()))
for steps in (10, 15):
    reply = {
        "actions": actions(steps), "state": np.arange(8.0),
        "policy_timing": {"infer_ms": np.float64(41.5)}, "server_timing": {"infer_ms": 42.25, "prev_total_ms": 50.5},
    }
    (folder / f"reply-{steps}.bin").write_bytes(msgpack_numpy.packb(reply))
(folder / "bare.bin").write_bytes(msgpack_numpy.packb(actions(4)))
resized = {
    f"{h}x{w}-{oh}x{ow}": image_tools.resize_with_pad(picture(h, w), oh, ow) for (h, w), (oh, ow) in SIZES
}
np.savez_compressed(folder / "resized.npz", **resized)
"""


def main() -> None:
    uv = ROOT / ".venv-uv" / "bin" / "uv"
    wanted = [part for package in PACKAGES for part in ("--with", package)]
    command = [uv, "run", "--no-project", "--python", sys.executable, *wanted, "python", "-c", SCRIPT, FOLDER, ROOT]
    FOLDER.mkdir(parents=True, exist_ok=True)
    subprocess.run(command, check=True)


if __name__ == "__main__":
    main()

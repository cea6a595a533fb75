"""Settings for other programs change no figure."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
from pathlib import Path

import matplotlib
from matplotlib.figure import Figure

from carecontact.plotting import plain_figures

DRAWN = """
import hashlib, io
from carecontact.plotting import plain_figures
with plain_figures({"lines.linewidth": 3.0}):
    from matplotlib.figure import Figure
    figure, file = Figure(figsize=(2, 1)), io.BytesIO()
    figure.subplots().set_title("a $b$")
    figure.savefig(file, format="png")
print(hashlib.sha256(file.getvalue()).hexdigest())
"""


def drawn(folder: Path, **variables: str) -> subprocess.CompletedProcess[str]:
    given = {name: value for name, value in os.environ.items() if not name.startswith("MPL")}
    return subprocess.run(
        [sys.executable, "-c", DRAWN], cwd=folder, env=given | variables, capture_output=True, text=True, check=False
    )


def test_neither_a_backend_nor_a_matplotlibrc_of_the_folder_changes_a_picture(tmp_path: Path) -> None:
    plain = drawn(tmp_path)
    (tmp_path / "matplotlibrc").write_text("text.usetex: True\nfigure.dpi: 10\nbackend: module://nonsense\n")
    for backend in ("nonsense", "module://nonsense", "TkAgg"):
        assert drawn(tmp_path, MPLBACKEND=backend).stdout == plain.stdout
    assert len(plain.stdout.strip()) == hashlib.sha256().digest_size * 2


def test_a_matplotlibrc_that_is_no_text_is_named(tmp_path: Path) -> None:
    (tmp_path / "matplotlibrc").write_bytes(b"\xff")
    told = drawn(tmp_path).stderr.splitlines()[-1]
    assert told.startswith("carecontact.errors.ConfigError: matplotlib cannot read a matplotlibrc file (in the current")


def test_the_settings_of_this_process_come_back() -> None:
    with matplotlib.rc_context({"text.usetex": True}):

        @plain_figures({"font.size": 3.0})
        def draw() -> tuple[bool, float]:
            return Figure().text(0, 0, "a").get_usetex(), matplotlib.rcParams["font.size"]

        assert draw() == (False, 3.0)
        assert matplotlib.rcParams["text.usetex"]

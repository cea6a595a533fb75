from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from carecontact.tissue import binary


@pytest.fixture
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The kernel's folder, copied; the library of this process stays loaded."""
    folder = tmp_path / "clone" / "src" / "carecontact" / "tissue"
    shutil.copytree(binary.FOLDER, folder, ignore=shutil.ignore_patterns("__pycache__"))
    monkeypatch.setattr(binary, "FOLDER", folder)
    monkeypatch.setattr(binary, "SOURCES", folder / "c")
    return folder

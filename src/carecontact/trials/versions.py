"""Versions of what decides a trial's numbers."""

from __future__ import annotations

import sys
from importlib import metadata

from carecontact import __version__

EMBODIMENT = "panda-closed-gripper-caps"


def package_versions() -> dict[str, str]:
    """Of what decides a trial's numbers, without importing any of it."""
    versions = {"python": ".".join(map(str, sys.version_info[:3])), "carecontact": __version__}
    for package in ("mujoco", "numpy", "scipy", "mediapipe", "opencv-python-headless"):
        try:
            versions[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            versions[package] = "not installed"
    return versions

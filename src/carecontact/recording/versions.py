"""Versions of what decides a trial's numbers."""

from __future__ import annotations

import sys
from importlib import metadata

from carecontact import __version__

SEGMENTER_PACKAGES = {"mediapipe": (), "grounded-sam": ("torch", "transformers", "tokenizers", "pillow")}
"""Segmenter -> what it runs on besides the packages of every trial."""


def package_versions(segmenter: str = "mediapipe") -> dict[str, str]:
    """Of what decides a trial's numbers, without importing any of it."""
    versions = {"python": ".".join(map(str, sys.version_info[:3])), "carecontact": __version__}
    packages = ("mujoco", "numpy", "scipy", "mediapipe", "opencv-python-headless")
    for package in (*packages, *SEGMENTER_PACKAGES[segmenter]):
        try:
            versions[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            versions[package] = "not installed"
    return versions

"""Versions of what decides a trial's numbers."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping
from importlib import metadata

from carecontact import __version__
from carecontact.contract.embodiment import EMBODIMENTS
from carecontact.contract.protocol import BEHAVIOURS, Protocol
from carecontact.regions import REGIONS

PACKAGES = ("mujoco", "numpy", "scipy", "mediapipe", "opencv-python-headless")
"""Packages on which the numbers of every trial rest."""
SEGMENTER_PACKAGES = {"mediapipe": (), "grounded-sam": ("torch", "transformers", "tokenizers", "pillow")}
"""Segmenter -> what it runs on besides the packages of every trial."""

DECLARED = {"world": "2", "kernel": "3", "perception": "1", "noise": "1"}
"""Part of the simulation -> its declared version, by which a recording says in which world its trial ran. The version
of a part is raised with every change that moves a number by more than rounding; tests/golden/test_declared.py presses
the person and compares with the numbers of this version, to a relative 5e-4. Bytes that depend on the machine, such as
those of the compiled model, are provenance and decide nothing: linear algebra rounds differently elsewhere."""


def trial_versions(protocol: Protocol) -> dict[str, str]:
    """Return the versions of everything that decides the numbers of a protocol's trials."""
    return package_versions(protocol.vision.segmenter) | supplier_versions(protocol)


def supplier_versions(protocol: Protocol) -> dict[str, str]:
    """Return the versions of the other packages that supply the robot, and actions and regions of the tasks."""
    suppliers = {BEHAVIOURS.package(task.action) for task in protocol.tasks}
    suppliers |= {REGIONS.package(task.region) for task in protocol.tasks} | {EMBODIMENTS.package(protocol.scene.tool)}
    return versions_of(suppliers)


def versions_of(packages: Iterable[str | None]) -> dict[str, str]:
    """Installed package -> its version, sorted; None stands for no package."""
    return {name: metadata.version(name) for name in sorted({name for name in packages if name is not None})}


def package_versions(segmenter: str = "mediapipe") -> dict[str, str]:
    """Return the versions of what decides a trial's numbers, without importing any of it."""
    versions = {"python": ".".join(map(str, sys.version_info[:3])), "carecontact": __version__}
    for package in (*PACKAGES, *SEGMENTER_PACKAGES[segmenter]):
        try:
            versions[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            versions[package] = "not installed"
    return versions


def missing_suppliers(versions: Mapping[str, str]) -> list[str]:
    """Name and version of the packages that supplied rows for a recording and are not installed here.

    Args:
        versions: of a recording's header.
    """
    known = {"python", "carecontact", *PACKAGES, *(name for names in SEGMENTER_PACKAGES.values() for name in names)}
    found: list[str] = []
    for name in sorted(versions.keys() - known):
        try:
            metadata.version(name)
        except metadata.PackageNotFoundError:
            found.append(f"{name} {versions[name]}")
    return found

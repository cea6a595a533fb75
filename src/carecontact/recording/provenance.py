"""What decided a trial's last bits: versions of packages, processor and kernels of linear algebra."""

from __future__ import annotations

import platform
import sys
from collections.abc import Iterable, Mapping
from importlib import metadata
from typing import cast

from carecontact import __version__
from carecontact.interface.regions import REGIONS
from carecontact.interface.robot import EMBODIMENTS
from carecontact.protocol.gates import ACTIONS
from carecontact.protocol.protocol import Protocol
from carecontact.recording.schema import Recording
from carecontact.system import installed_version

PACKAGES = ("mujoco", "numpy", "scipy", "ai-edge-litert", "pillow")
"""Packages on which the numbers of every trial rest."""
SEGMENTER_PACKAGES = {"mediapipe": (), "grounded-sam": ("torch", "transformers", "tokenizers")}
"""Segmenter -> what it runs on besides the packages of every trial."""

DECLARED = {"world": "3", "kernel": "3", "perception": "2", "noise": "1"}
"""Part of the simulation -> its declared version, by which a recording says in which world its trial ran. The version
of a part is raised with every change that moves a number by more than rounding; tests/golden/test_declared.py presses
the person and compares with the numbers of this version, to a relative 5e-4. Bytes that depend on the machine, such as
those of the compiled model, are provenance and decide nothing: linear algebra rounds differently elsewhere."""


def trial_versions(protocol: Protocol) -> dict[str, str]:
    """Return the versions of everything that decides the numbers of a protocol's trials."""
    return package_versions(protocol.vision.segmenter) | supplier_versions(protocol)


def supplier_versions(protocol: Protocol) -> dict[str, str]:
    """Return the versions of the other packages that supply the robot, and actions and regions of the tasks."""
    suppliers = {ACTIONS.package(task.action) for task in protocol.tasks}
    suppliers |= {REGIONS.package(task.region) for task in protocol.tasks} | {EMBODIMENTS.package(protocol.scene.tool)}
    return versions_of(suppliers)


def versions_of(packages: Iterable[str | None]) -> dict[str, str]:
    """Installed package -> its version, sorted; None stands for no package."""
    return {name: metadata.version(name) for name in sorted({name for name in packages if name is not None})}


def package_versions(segmenter: str = "mediapipe") -> dict[str, str]:
    """Return the versions of what decides a trial's numbers, without importing any of it."""
    versions = {"python": ".".join(map(str, sys.version_info[:3])), "carecontact": __version__}
    for package in (*PACKAGES, *SEGMENTER_PACKAGES[segmenter]):
        versions[package] = installed_version(package) or "not installed"
    return versions


def missing_suppliers(versions: Mapping[str, str]) -> list[str]:
    """Name and version of packages that supplied rows for a recording, by its header, and are not installed."""
    known = {"python", "carecontact", *PACKAGES, *(name for names in SEGMENTER_PACKAGES.values() for name in names)}
    return [f"{name} {versions[name]}" for name in sorted(versions.keys() - known) if installed_version(name) is None]


ARITHMETIC = "wall/arithmetic"
"""Array of a recording with the text as UTF-8. It lies outside the canonical hash, because other libraries that round
alike make the same recording."""

RENDERER = "wall/renderer"
"""Array with vendor, renderer and version of OpenGL as UTF-8: two renderers draw slightly different pictures."""


def provenance_of(recording: Recording) -> dict[str, str]:
    """Return what computed and drew a recording, as far as recorded: see ``TrialScore.provenance``."""
    texts = {"arithmetic": ARITHMETIC, "renderer": RENDERER}
    found = {
        name: recording[path].tobytes().decode(errors="replace") for name, path in texts.items() if path in recording
    }
    if recording.header.origin != "isolated":
        found["origin"] = recording.header.origin
    return found | {
        name: recording.header.sha256[name] for name in ("model", "kernel") if name in recording.header.sha256
    }


def arithmetic() -> str:
    """Return numpy's library of linear algebra with the kernels that it chose, the processor family, and the C library,
    as in ``openblas 0.3.31 SkylakeX on x86_64 with glibc 2.36``.

    OpenBLAS chooses its kernels by what the processor can do (``OPENBLAS_CORETYPE`` overrides it). Each sums a product
    of matrices in another order, and contact amplifies the last bits of a model that was built with such products.
    Two machines with the same text make the same recordings.
    """
    # Here, because it looks through all libraries of the process, and few callers need it.
    from threadpoolctl import threadpool_info  # pyright: ignore[reportMissingTypeStubs]

    libraries, none = cast("list[dict[str, str]]", threadpool_info()), dict[str, str]()
    # scipy brings its own.
    blas = (row for row in libraries if row["user_api"] == "blas")
    row = min(blas, key=lambda row: "numpy" not in row["filepath"], default=none)
    algebra = " ".join(row[key] for key in ("internal_api", "version", "architecture") if row.get(key))
    library = " ".join(filter(None, platform.libc_ver())) or "an unknown C library"
    return f"{algebra or 'unknown linear algebra'} on {platform.machine()} with {library}"

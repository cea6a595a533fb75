"""Puts the compiled tissue into the wheel, or beside its sources where carecontact is installed from a clone; and the
kept scores of the shipped policies into the wheel."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

sys.path.insert(0, str(Path(__file__).parent / "tools"))
from compile_kernel import binary, compile_kernel

PLATFORM_VARIABLE = "CARECONTACT_PLATFORM"
"""Environment variable that names another platform than this machine's (tools/wheels.py)."""


class KernelBuildHook(BuildHookInterface):
    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """A platform without a binary gets the rest of the package, which scores and reports recorded trials."""
        if version != "editable":
            # A report finds floor and ceiling there (report/baselines.py); a clone has them in docs.
            for scores in Path(self.root, "docs", "results").glob("bathing-*/"):
                build_data["force_include"][str(scores)] = f"carecontact/assets/results/{scores.name}"
        chosen = os.environ.get(PLATFORM_VARIABLE)
        if chosen and chosen not in binary.PLATFORMS:
            raise SystemExit(f"{PLATFORM_VARIABLE}={chosen} is not a platform; valid: {', '.join(binary.PLATFORMS)}")
        platform = chosen or binary.platform_here()
        if platform not in binary.PLATFORMS:
            return
        target, build = binary.PLATFORMS[platform], Path(self.root, "build")
        if version == "editable":
            library = binary.library_file(platform)
            if binary.fault(platform):
                compile_kernel(library, platform, cache=build / "zig")
        else:
            library = build / "kernel" / platform / target.library
            compile_kernel(library, platform, cache=build / "zig")
            build_data["force_include"][str(library)] = f"carecontact/tissue/{target.library}"
        build_data["pure_python"] = False
        build_data["tag"] = f"py3-none-{target.tag}"

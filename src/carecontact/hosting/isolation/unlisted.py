"""Makes imports work from a folder that may not be listed because something in it is closed to the policy."""

from __future__ import annotations

import os
from collections.abc import Sequence
from importlib.abc import MetaPathFinder
from importlib.machinery import EXTENSION_SUFFIXES, SOURCE_SUFFIXES, ModuleSpec, PathFinder
from importlib.util import spec_from_file_location
from types import ModuleType


class UnlistedFolders(MetaPathFinder):
    """A finder for the end of ``sys.meta_path``. Python's own finder lists a folder first; this one asks for one
    file.
    """

    def __init__(self, folders: Sequence[str]) -> None:
        self._folders = folders

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None, /
    ) -> ModuleSpec | None:
        """Find a top-level module; None for others, because Python's own finder sees what lies in a package."""
        for folder in self._folders if path is None else ():
            package = os.path.join(folder, fullname)
            if os.path.isfile(start := os.path.join(package, "__init__.py")):
                return spec_from_file_location(fullname, start, submodule_search_locations=[package])
            for file in (package + suffix for suffix in (*SOURCE_SUFFIXES, *EXTENSION_SUFFIXES)):
                if os.path.isfile(file):
                    return spec_from_file_location(fullname, file)
            if os.path.isdir(package):
                return PathFinder.find_spec(fullname, [folder]) or _namespace(fullname, package)
        return None


def _namespace(fullname: str, package: str) -> ModuleSpec:
    spec = ModuleSpec(fullname, None, is_package=True)
    spec.submodule_search_locations = [package]
    return spec

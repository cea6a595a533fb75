"""One registry for everything a user can name: tasks, policies, bodies, metrics."""

from __future__ import annotations

import pkgutil
from collections.abc import Callable, Iterator, Mapping
from importlib import import_module
from importlib.metadata import entry_points
from typing import Generic, TypeVar

from carecontact.errors import ConfigError, UnknownNameError

T = TypeVar("T")


class Registry(Mapping[str, T], Generic[T]):
    """Maps a name to a row.

    Three places supply rows: ``register``, the modules of the package ``scan``, and other installed packages through
    the entry-point group ``carecontact.<plural>``. The last two are loaded when a name is first looked up.
    """

    def __init__(self, kind: str, *, plural: str | None = None, scan: str | None = None) -> None:
        """
        Args:
            kind: what a row is, as error messages name it.
            plural: of ``kind``, where it is not just an s longer.
            scan: dotted name of a package whose modules register rows when they are imported.
        """
        self.kind, self.plural = kind, plural or f"{kind}s"
        self._rows: dict[str, T] = {}
        self._package: dict[str, str] = {}
        self._scan = scan
        self._scanned = self._external_loaded = False

    def register(self, name: str, row: T) -> T:
        """Add a row. Raises ConfigError if the name is taken."""
        if name in self._rows:
            raise ConfigError(f"{self.kind} {name!r} is registered twice")
        self._rows[name] = row
        return row

    def decorator(self, name: str) -> Callable[[T], T]:
        return lambda row: self.register(name, row)

    def package(self, name: str) -> str | None:
        """The installed package whose entry point supplied the row; None for any other row."""
        self._load()
        return self._package.get(name)

    def __getitem__(self, name: str) -> T:
        """Raises UnknownNameError, which lists the valid names."""
        self._load_scanned()
        if name not in self._rows:
            self._load_external()
        try:
            return self._rows[name]
        except KeyError:
            raise UnknownNameError(self.kind, name, self._rows) from None

    def __contains__(self, name: object) -> bool:
        self._load()
        return name in self._rows

    def __iter__(self) -> Iterator[str]:
        self._load()
        return iter(sorted(self._rows))

    def __len__(self) -> int:
        self._load()
        return len(self._rows)

    def _load(self) -> None:
        self._load_scanned()
        self._load_external()

    def _load_scanned(self) -> None:
        if self._scanned or self._scan is None:
            return
        self._scanned = True  # before the imports: a module that looks a name up must not start the scan again
        package = import_module(self._scan)
        for module in sorted(m.name for m in pkgutil.iter_modules(package.__path__)):
            import_module(f"{self._scan}.{module}")

    def _load_external(self) -> None:
        if self._external_loaded:
            return
        for point in entry_points(group=f"carecontact.{self.plural}"):
            if point.name in self._rows:
                continue
            # A module may register its row as it is imported; then the object that the entry point names is ignored.
            self._rows.setdefault(point.name, point.load())
            if point.dist is not None:
                self._package[point.name] = point.dist.name
        self._external_loaded = True

"""The registry class, which serves everything that a user can name, such as policies, bodies and metrics."""

from __future__ import annotations

import pkgutil
import sys
from collections.abc import Iterator, Mapping
from contextlib import suppress
from functools import cache
from importlib import import_module, metadata
from importlib.metadata import EntryPoint, EntryPoints
from typing import Any, Generic, TypeVar

from carecontact.errors import CarecontactError, ConfigError, UnknownNameError

T = TypeVar("T")


@cache
def _points_on(path: tuple[str, ...]) -> Any:
    """Of the packages that are installed on a search path, which is ``sys.path``."""
    return metadata.entry_points()


def entry_points(*, group: str) -> EntryPoints:
    """Those of all installed packages. Their folders are read once for all groups."""
    return _points_on(tuple(sys.path)).select(group=group)


class Registry(Mapping[str, T], Generic[T]):
    """Maps a name to a row, from ``register``, the modules of the package ``scan``, or entry points
    ``carecontact.<plural>``, which are loaded when looked up: a faulty package harms only its own users."""

    def __init__(
        self,
        kind: str,
        *,
        row: type[Any] = object,
        expected: str | None = None,
        plural: str | None = None,
        scan: str | None = None,
    ) -> None:
        """
        Args:
            kind: what a row is, as error messages name it.
            row: class that every row is an object of.
            expected: the same in words, where the name of the class does not say it.
            plural: of ``kind``, where it is not just an s longer.
            scan: dotted name of a package whose modules register rows when they are imported.
        """
        self.kind, self.plural = kind, plural or f"{kind}s"
        self._row, self._expected = row, expected or f"a {row.__name__} object"
        self._rows: dict[str, T] = {}
        self._origins: dict[str, object] = {}
        self._scan, self._scanned = scan, False
        self._points: dict[str, list[EntryPoint]] | None = None
        self._faults: dict[str, str] = {}
        """Name that was looked up -> why its package's row cannot be loaded; empty if it can, or no package has it."""

    def register(self, name: str, row: T, *, origin: object = None) -> T:
        """Add a row; ``origin`` is what an entry point names for it. Raises ConfigError for a taken name or a wrong
        class."""
        if name in self._rows:
            raise ConfigError(f"{self.kind} {name!r} is registered twice")
        self._check(row, f"{self.kind} {name!r}")
        self._rows[name] = row
        self._origins[name] = row if origin is None else origin
        return row

    def package(self, name: str) -> str | None:
        """The installed package whose entry point supplies the row; None for any other row."""
        return next((point.dist.name for point in self._installed().get(name, []) if point.dist is not None), None)

    def title(self, name: str) -> str:
        """The row as messages name it: ``action 'touch'``, ``action 'hold' of package outside 1.0 (outside:HOLD)``."""
        return next(map(self._title, self._installed().get(name, [])), f"{self.kind} {name!r}")

    def usable(self) -> dict[str, T]:
        """Name -> row, without the rows that cannot be loaded."""
        found: dict[str, T] = {}
        for name in self:
            with suppress(ConfigError):
                found[name] = self[name]
        return found

    def __getitem__(self, name: str) -> T:
        """Raises UnknownNameError, or ConfigError for a row that does not load or a name that several packages have."""
        self._load_scanned()
        if name not in self._faults:
            try:
                self._load(self._installed().get(name, []))
            except ConfigError as error:
                self._faults[name] = str(error)
                raise
            self._faults[name] = ""
        if self._faults[name]:
            raise ConfigError(self._faults[name])
        try:
            return self._rows[name]
        except KeyError:
            raise UnknownNameError(self.kind, name, self) from None

    def __contains__(self, name: object) -> bool:
        self._load_scanned()
        return name in self._rows or name in self._installed()

    def __iter__(self) -> Iterator[str]:
        self._load_scanned()
        return iter(sorted(self._rows.keys() | self._installed().keys()))

    def __len__(self) -> int:
        return len(list(iter(self)))

    def _load_scanned(self) -> None:
        if self._scanned or self._scan is None:
            return
        self._scanned = True  # before the imports: a module that looks a name up must not start the scan again
        package = import_module(self._scan)
        for module in sorted(m.name for m in pkgutil.iter_modules(getattr(package, "__path__", []))):
            import_module(f"{self._scan}.{module}")

    def _installed(self) -> dict[str, list[EntryPoint]]:
        """Name -> the entry points that have it; nothing is loaded."""
        if self._points is None:
            self._points = {}
            for point in entry_points(group=f"carecontact.{self.plural}"):
                self._points.setdefault(point.name, []).append(point)
        return self._points

    def _load(self, points: list[EntryPoint]) -> None:
        if not points:
            return
        point, title = points[0], self._title(points[0])
        for other in points[1:]:
            if other.value != point.value:
                raise ConfigError(f"{title} has the same name as {self._title(other)}; rename or uninstall one of them")
        try:
            found = point.load()
        except Exception as error:  # another package's module may raise anything
            why = "" if isinstance(error, CarecontactError) else f"{type(error).__name__}: "
            raise ConfigError(f"{title} cannot be loaded: {why}{' '.join(str(error).split())}") from error
        if point.name not in self._rows:
            aliases = [name for name, origin in self._origins.items() if origin is found]
            if aliases:
                raise ConfigError(f"{title} registers itself as {aliases[0]!r}; give its entry point the same name")
            self._check(found, title)
            self.register(point.name, found)
        elif self._origins.get(point.name) is not found:
            raise ConfigError(
                f"{title} has the name of another {self.kind}, which carecontact or this process registered; rename it"
            )

    def _title(self, point: EntryPoint) -> str:
        package = f" of package {point.dist.name} {point.dist.version}" if point.dist is not None else ""
        return f"{self.kind} {point.name!r}{package} ({point.value})"

    def _check(self, row: object, title: str) -> None:
        if self._row is object:
            return
        if isinstance(row, type):
            raise ConfigError(f"{title} is the class {row.__name__}; expected {self._expected}")
        if not isinstance(row, self._row):
            raise ConfigError(f"{title} is a {type(row).__name__}; expected {self._expected}")

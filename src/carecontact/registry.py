"""One registry for everything a user can name: tasks, policies, bodies, metrics."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from importlib.metadata import entry_points
from typing import Generic, TypeVar

from carecontact.errors import ConfigError, UnknownNameError

T = TypeVar("T")


class Registry(Mapping[str, T], Generic[T]):
    """Name -> row. Rows of other packages arrive through entry-point group ``carecontact.<plural>``."""

    def __init__(self, kind: str, *, plural: str | None = None) -> None:
        """``plural``: of ``kind``, where it is not just an s longer."""
        self.kind, self.plural = kind, plural or f"{kind}s"
        self._rows: dict[str, T] = {}
        self._external_loaded = False

    def register(self, name: str, row: T) -> T:
        """Add a row. Raises ConfigError if the name is taken."""
        if name in self._rows:
            raise ConfigError(f"{self.kind} {name!r} is registered twice")
        self._rows[name] = row
        return row

    def decorator(self, name: str) -> Callable[[T], T]:
        return lambda row: self.register(name, row)

    def __getitem__(self, name: str) -> T:
        """Raises UnknownNameError, which lists the valid names."""
        if name not in self._rows:
            self._load_external()
        try:
            return self._rows[name]
        except KeyError:
            raise UnknownNameError(self.kind, name, self._rows) from None

    def __contains__(self, name: object) -> bool:
        self._load_external()
        return name in self._rows

    def __iter__(self) -> Iterator[str]:
        self._load_external()
        return iter(sorted(self._rows))

    def __len__(self) -> int:
        self._load_external()
        return len(self._rows)

    def _load_external(self) -> None:
        if self._external_loaded:
            return
        for point in entry_points(group=f"carecontact.{self.plural}"):
            self._rows.setdefault(point.name, point.load())
        self._external_loaded = True

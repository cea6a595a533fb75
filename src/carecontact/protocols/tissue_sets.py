"""Named sets of tissue laws: one TOML file each, a row per soft region; a protocol names one."""

from __future__ import annotations

import hashlib
import json
import tomllib
from importlib import resources
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from carecontact.contract.protocol import FileStem, Protocol, RegionName, Section, Tissue
from carecontact.errors import ConfigError, UnknownNameError
from carecontact.protocols.wrong_fields import wrong_fields
from carecontact.regions import STANDARD_REGIONS


class TissueSet(Section):
    id: FileStem
    description: str
    base: str | None = None
    """The set from which regions without a row of their own are taken."""
    tissue: dict[RegionName, Tissue]

    @property
    def sha256(self) -> str:
        """Hash of the rows as canonical JSON: spelling, comments and name do not count."""
        rows = {region: row.model_dump(mode="json") for region, row in self.tissue.items()}
        return hashlib.sha256(json.dumps(rows, sort_keys=True).encode()).hexdigest()


def shipped_tissue_sets() -> list[str]:
    folder = resources.files("carecontact.protocols") / "tissue"
    return sorted(p.name.removesuffix(".toml") for p in folder.iterdir() if p.name.endswith(".toml"))


def load_tissue_set(*names_or_paths: str) -> TissueSet:
    """Return a shipped set by id, or a TOML file by path; regions that it leaves out come from its base.

    Of several, every one gives its own rows, and they need one base for the regions of which none has a row.

    Raises UnknownNameError, or ConfigError naming file, field and what was expected.
    """
    sets = {name: _read(name) for name in names_or_paths}
    rows, owner = dict[str, Tissue](), dict[str, str]()
    for name, made in sets.items():
        for region, row in made.tissue.items():
            if region in owner:
                raise ConfigError(
                    f"tissue sets {owner[region]} and {name} both have a row for the {region}; give only one of them"
                )
            rows[region], owner[region] = row, name
    missing = [region for region in STANDARD_REGIONS if region not in rows]
    bases = sorted({made.base for made in sets.values() if made.base is not None})
    told = f"tissue set{'s' * (len(sets) > 1)} {' and '.join(sets)}"
    if missing and len(bases) != 1:
        hint = f"add base = one of {', '.join(shipped_tissue_sets())}, whose rows then serve"
        if bases:
            hint = f"their bases differ ({', '.join(bases)}); give them one"
        raise ConfigError(f"{told}: no row for {', '.join(missing)}; {hint}")
    for base in bases:
        if base not in shipped_tissue_sets():
            raise ConfigError(f"{told}: base {base!r}; valid: {', '.join(shipped_tissue_sets())}")
        rows = {**_read(base).tissue, **rows} if base == bases[0] else rows
    first = next(iter(sets.values()))
    return first.model_copy(update={"id": "+".join(made.id for made in sets.values()), "tissue": rows})


def check_accepted(protocol: Protocol, *, allowed: bool) -> None:
    """Raise ConfigError for a row that ``carecontact calibrate`` rejected, unless these are allowed."""
    rejected = protocol.person.rejected_tissue
    if rejected and not allowed:
        raise ConfigError(
            f"{protocol.title}: the calibration of its tissue was rejected: {rejected}; --allow-rejected uses it, and "
            "every report then says so"
        )


def _read(name_or_path: str) -> TissueSet:
    """Return a set with the rows of its own file."""
    shipped = name_or_path in shipped_tissue_sets()
    if shipped:
        data = (resources.files("carecontact.protocols") / "tissue" / f"{name_or_path}.toml").read_bytes()
    elif name_or_path.endswith(".toml"):
        try:
            data = Path(name_or_path).read_bytes()
        except OSError as error:
            raise ConfigError(f"tissue set {name_or_path}: {error.strerror}") from None
    else:
        raise UnknownNameError("tissue set", name_or_path, [*shipped_tissue_sets(), "FILE.toml"])
    table: dict[str, Any] = {}
    try:
        table = tomllib.loads(data.decode())
        made = TissueSet.model_validate(table)
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ConfigError(f"tissue set {name_or_path}: not TOML: {error}") from None
    except ValidationError as error:
        raise ConfigError(wrong_fields(f"tissue set {name_or_path}", error, model=TissueSet, content=table)) from None
    if not shipped and made.id in shipped_tissue_sets():
        raise ConfigError(f"tissue set {name_or_path}: the id {made.id} is a shipped set's; choose another")
    return made

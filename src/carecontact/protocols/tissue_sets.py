"""Named sets of tissue laws: one TOML file each, a row per soft region; a protocol names one."""

from __future__ import annotations

import hashlib
import json
import tomllib
from importlib import resources
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from carecontact.contract.protocol import FileStem, RegionName, Section, Tissue
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


def load_tissue_set(name_or_path: str) -> TissueSet:
    """Return a shipped set by id, or a TOML file by path; regions that it leaves out come from its base.

    Raises UnknownNameError, or ConfigError naming file, field and what was expected.
    """
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
    missing = [region for region in STANDARD_REGIONS if region not in made.tissue]
    if missing and made.base is None:
        raise ConfigError(
            f"tissue set {name_or_path}: no row for {', '.join(missing)}; add base = one of "
            f"{', '.join(shipped_tissue_sets())}, whose rows then serve"
        )
    if made.base is not None:
        if made.base not in shipped_tissue_sets():
            raise ConfigError(
                f"tissue set {name_or_path}: base {made.base!r}; valid: {', '.join(shipped_tissue_sets())}"
            )
        made = made.model_copy(update={"tissue": {**load_tissue_set(made.base).tissue, **made.tissue}})
    return made

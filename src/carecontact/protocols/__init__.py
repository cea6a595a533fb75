"""Protocol files and how one is loaded."""

from __future__ import annotations

import tomllib
from importlib import resources
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from carecontact.contract.protocol import Protocol, Vision
from carecontact.errors import ConfigError, UnknownNameError
from carecontact.protocols.wrong_fields import wrong_fields

DEFAULT_PROTOCOL = "bathing-v1"


def shipped_protocols() -> list[str]:
    return sorted(p.name.removesuffix(".toml") for p in resources.files(__name__).iterdir() if p.name.endswith(".toml"))


def protocol_file(name_or_path: str) -> Path:
    """Of a shipped protocol, or the TOML file itself. Raises UnknownNameError, or ConfigError for a missing file."""
    if name_or_path in shipped_protocols():
        return Path(str(resources.files(__name__) / f"{name_or_path}.toml"))
    if not name_or_path.endswith(".toml"):
        raise UnknownNameError("protocol", name_or_path, shipped_protocols())
    if not Path(name_or_path).is_file():
        raise ConfigError(f"protocol file {name_or_path} does not exist")
    return Path(name_or_path)


def load_protocol(name_or_path: str = DEFAULT_PROTOCOL) -> Protocol:
    """A shipped protocol by id, or a TOML file by path.

    Raises UnknownNameError, or ConfigError naming file, field and what was expected.
    """
    data, place = protocol_file(name_or_path).read_bytes(), name_or_path
    try:
        protocol = Protocol.model_validate(_with_tissue(tomllib.loads(data.decode())))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ConfigError(f"{place}: not TOML: {error}") from None
    except ValidationError as error:
        raise ConfigError(wrong_fields(place, error)) from None
    if protocol.overrides:
        raise ConfigError(f"{place}: overrides are written by a command, never by a file; change the fields themselves")
    return protocol


def _with_tissue(fields: dict[str, Any]) -> dict[str, Any]:
    """A file that only names a tissue set gets its rows; one that spells the rows out keeps them."""
    from carecontact.protocols.tissue_sets import load_tissue_set

    person = fields.get("person")
    if not isinstance(person, dict) or "tissue" in person or not isinstance(person.get("tissue_set"), str):
        return fields
    rows = load_tissue_set(person["tissue_set"]).tissue
    return {**fields, "person": {**person, "tissue": {region: row.model_dump() for region, row in rows.items()}}}


FAST_DT_S = 0.004
"""The fast mode's physics step; ``carecontact validate`` shows what it does to the scores."""


def adapted(
    protocol: Protocol,
    *,
    body: str | None = None,
    tissue: str | None = None,
    fast: bool = False,
    stiffness_n_m: float | None = None,
    vision: Vision | None = None,
) -> Protocol:
    """The protocol with what is given in place of its own; its title, hash and every output say so.

    Args:
        body: a shipped body or ``smplx:FILE.npz?sex=F``.
        tissue: a shipped tissue set or a TOML file.
        fast: physics steps of FAST_DT_S.
        stiffness_n_m: of the arm's translation, within the protocol's own bounds.
        vision: the segmenter and its weights.

    Raises UnknownNameError, or ConfigError naming file, field and what was expected.
    """
    from carecontact.protocols.tissue_sets import load_tissue_set

    chosen = None if tissue is None else load_tissue_set(tissue)
    low, high = protocol.impedance.translational_bounds
    if stiffness_n_m is not None and not low <= stiffness_n_m <= high:
        raise ConfigError(f"stiffness {stiffness_n_m:g} N/m: {protocol.id} allows {low:g} to {high:g} N/m")
    return protocol.overridden(
        body=body,
        tissue_set=None if chosen is None else (chosen.id, dict(chosen.tissue)),
        dt_s=FAST_DT_S if fast else None,
        stiffness_n_m=stiffness_n_m,
        vision=vision,
    )

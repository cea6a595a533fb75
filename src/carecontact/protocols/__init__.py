"""Protocol files and how one is loaded."""

from __future__ import annotations

import tomllib
from importlib import resources
from pathlib import Path

from pydantic import ValidationError

from carecontact.contract.protocol import Protocol
from carecontact.errors import ConfigError, UnknownNameError

DEFAULT_PROTOCOL = "bathing-v1-draft"


def shipped_protocols() -> list[str]:
    return sorted(p.name.removesuffix(".toml") for p in resources.files(__name__).iterdir() if p.name.endswith(".toml"))


def load_protocol(name_or_path: str = DEFAULT_PROTOCOL) -> Protocol:
    """A shipped protocol by id, or a TOML file by path.

    Raises UnknownNameError, or ConfigError naming file, field and what was expected.
    """
    if name_or_path in shipped_protocols():
        data, place = (resources.files(__name__) / f"{name_or_path}.toml").read_bytes(), name_or_path
    elif name_or_path.endswith(".toml"):
        path = Path(name_or_path)
        if not path.is_file():
            raise ConfigError(f"protocol file {path} does not exist")
        data, place = path.read_bytes(), str(path)
    else:
        raise UnknownNameError("protocol", name_or_path, shipped_protocols())
    try:
        return Protocol.model_validate(tomllib.loads(data.decode()))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ConfigError(f"{place}: not TOML: {error}") from None
    except ValidationError as error:
        lines = [f"  {'.'.join(map(str, e['loc']))}: {e['msg']} (got {str(e['input'])[:80]})" for e in error.errors()]
        raise ConfigError(f"{place}: {len(lines)} field(s) wrong\n" + "\n".join(lines)) from None

"""Which blind baselines stand beside a run: named once, they stay in its report however often that is written again."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from carecontact.errors import ConfigError
from carecontact.recording.writer import replace_file

BASELINES = "baselines.json"
SCHEMA = "carecontact-baselines-1"


class _Named(BaseModel):
    model_config = ConfigDict(extra="forbid")

    version: Annotated[Literal["carecontact-baselines-1"], Field(alias="schema")]
    runs: list[str]
    """Relative to the run's own folder, so that both can be moved together."""


def remember(folder: Path, baselines: Sequence[Path]) -> None:
    """Write which runs stand beside the run in ``folder``, in place of those that stood there."""
    places = [os.path.relpath(path.resolve(), folder.resolve()) for path in baselines]
    content = json.dumps({"schema": SCHEMA, "runs": places}, indent=1)
    replace_file(folder / BASELINES, f"{content}\n".encode())


def remembered(folder: Path) -> dict[str, Path]:
    """Name of each baseline as the file has it -> its place; empty without a file.

    Raises ConfigError for a file that is damaged.
    """
    path = folder / BASELINES
    if not path.is_file():
        return {}
    try:
        found = _Named.model_validate_json(path.read_bytes())
    except ValidationError as error:
        first = error.errors()[0]
        why = f"{'.'.join(map(str, first['loc'])) or 'content'}: {first['msg']}"
        raise ConfigError(f"{path} is damaged ({why}); name the baselines again with --baseline RUN...") from None
    return {name: Path(os.path.normpath(folder / name)) for name in found.runs}

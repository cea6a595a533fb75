"""Which null arms stand beside a run: named once, they stay in its report however often that is written again."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from carecontact.cli.compare import read_scores
from carecontact.errors import CarecontactError, ConfigError
from carecontact.recording.writer import replace_file

if TYPE_CHECKING:
    from carecontact.reports.compare.null_floors import NullFloors
    from carecontact.runs.run_scores import RunScores

NULL_ARMS = "null_arms.json"


class _NullArms(BaseModel):
    model_config = ConfigDict(extra="forbid")

    version: Annotated[Literal["carecontact-null-arms-1"], Field(alias="schema")] = "carecontact-null-arms-1"
    runs: list[str]
    """Against the run's own folder, so that both can be moved together."""


def named_floors(folder: Path, run: RunScores, nulls: Sequence[Path]) -> NullFloors:
    """Of the null arms named now, which are remembered in the run's folder in place of those before.

    Raises ConfigError for one that cannot be read or compared; then nothing is remembered.
    """
    from carecontact.reports.compare.null_floors import null_floors

    floors = null_floors(run, [read_scores(path) for path in nulls])
    places = [os.path.relpath(path.resolve(), folder.resolve()) for path in nulls]
    content = json.dumps({"schema": "carecontact-null-arms-1", "runs": places}, indent=1)
    replace_file(folder / NULL_ARMS, f"{content}\n".encode())
    return floors


def remembered_floors(folder: Path, run: RunScores) -> tuple[NullFloors | None, dict[str, str]]:
    """Of the null arms that were named before, read anew; and arm or file -> why it cannot be shown any more."""
    from carecontact.reports.compare.null_floors import null_floors

    arms: list[RunScores] = []
    lost: dict[str, str] = {}
    try:
        places = _remembered(folder)
    except ConfigError as error:
        return None, {NULL_ARMS: str(error)}
    for place in places:
        try:
            arm = read_scores(Path(os.path.normpath(folder / place)))
            null_floors(run, [*arms, arm])
        except CarecontactError as error:
            lost[place] = str(error)
        else:
            arms.append(arm)
    return (null_floors(run, arms) if arms else None), lost


def _remembered(folder: Path) -> list[str]:
    path = folder / NULL_ARMS
    try:
        return _NullArms.model_validate_json(path.read_bytes()).runs
    except FileNotFoundError:
        return []
    except ValidationError as error:
        first = error.errors()[0]
        why = f"{'.'.join(map(str, first['loc'])) or 'content'}: {first['msg']}"
        raise ConfigError(f"{path} is damaged ({why}); name the null arms again with --null RUN...") from None

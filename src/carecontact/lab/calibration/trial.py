"""One measured press in SI units, and what a user may state of presses that their file does not say."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from carecontact.errors import ConfigError
from carecontact.protocol.field_errors import wrong_fields

Array = npt.NDArray[np.float64]
Shape = Literal["flat", "hemisphere", "cap"]
PHASES = ("load", "hold", "unload")
SHAPES = get_args(Shape)
LIMITS = {
    "speed_mm_s": (0.05, 500.0),
    "indenter_size_mm": (1.0, 100.0),
    "preload_N": (0.0, 20.0),
    "along_mm": (-300.0, 300.0),
    "across_mm": (-300.0, 300.0),
    "tilt_deg": (-45.0, 45.0),
}


@dataclass(frozen=True, kw_only=True)
class Condition:
    """Indenter, speed and place of a press, which its replay has to match."""

    indenter_shape: str
    indenter_size_m: float | None
    """Radius [m]; None for the cap, which has the size of the shipped tool."""
    speed_m_s: float
    along_m: float
    across_m: float
    tilt_deg: float


@dataclass(frozen=True, kw_only=True)
class Trial:
    trial_id: str
    site: str
    subject: str
    condition: Condition
    preload_n: float
    filter: str
    time_s: Array
    """(n,) increasing, from 0"""
    indentation_m: Array
    """(n,) as recorded; the user chose its zero"""
    force_n: Array
    """(n,) as recorded, compression positive"""
    phase: npt.NDArray[np.int64]
    """(n,) index into PHASES"""
    path: Path
    """The file, and"""
    line: int
    """the line of its first row in it."""

    @property
    def unloads(self) -> bool:
        return int((self.phase == PHASES.index("unload")).sum()) >= 5


class _Stated(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")

    site: str | None = None
    subject: str | None = None
    indenter_shape: Shape | None = None
    indenter_size_mm: Annotated[float, Field(ge=1, le=100)] | None = None
    speed_mm_s: Annotated[float, Field(ge=0.05, le=500)] | None = None
    preload_N: Annotated[float, Field(ge=0, le=20)] | None = None
    filter: str | None = None
    along_mm: Annotated[float, Field(ge=-300, le=300)] | None = None
    across_mm: Annotated[float, Field(ge=-300, le=300)] | None = None
    tilt_deg: Annotated[float, Field(ge=-45, le=45)] | None = None


class Setup(_Stated):
    """Values of columns that the files do not have, for all presses and for those of one file."""

    files: dict[str, _Stated] = {}
    """Name of a file, without its folder -> what holds for it alone."""

    @classmethod
    def checked(cls, content: dict[str, Any], *, place: str) -> Setup:
        """Raises ConfigError naming the field and what was expected."""
        try:
            return cls.model_validate(content)
        except ValidationError as error:
            raise ConfigError(wrong_fields(place, error, model=cls, content=content)) from None

    def of(self, path: Path) -> dict[str, str | float]:
        """Return column -> value for the presses of a file."""
        common = self.model_dump(exclude_none=True, exclude={"files"})
        return common | self.files.get(path.name, _Stated()).model_dump(exclude_none=True)


def read_setup(path: Path) -> Setup:
    """Read a TOML file with the fields of Setup. Raises ConfigError naming the field and what was expected."""
    try:
        return Setup.checked(tomllib.loads(path.read_bytes().decode()), place=f"setup {path}")
    except OSError as error:
        raise ConfigError(f"setup {path}: {error.strerror}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ConfigError(f"setup {path}: not TOML: {error}") from None


def template() -> str:
    """Return a file of one press that is read as it is, with a comment for each thing that a user has to change."""
    rows = []
    for k, d in enumerate(np.r_[np.linspace(-1.0, 4.0, 26), np.linspace(3.8, -1.0, 25)]):
        force = max(0.9 * d + 0.07 * d * abs(d), 0.0) * (1.0 if k < 26 else 0.85)
        rows.append(f"press-1,forearm synthetic,person-1,{0.02 * k:.2f},{d:.2f},{force:.3f},flat,10.7,0,0,0\n")
    return _TEMPLATE + "".join(rows)


_TEMPLATE = """\
# Template of carecontact calibrate, with one made-up press. Replace its rows by yours; docs/person.md has
# every column. One row is one sample; a press goes in, may wait, and goes out. Start 1 mm outside the skin.
# trial_id: one press, its rows together. Without this column, one file is one press.
# site: begins with forearm, upper arm or abdomen. subject: who was pressed.
# indentation_mm: along the press, inward positive, any zero. force_N: compression positive.
# indenter_shape: flat or hemisphere, with its radius in indenter_size_mm. cap: the shipped tool.
# along_mm, across_mm, tilt_deg: place from the region's middle, and lean. What holds for all presses can stand
# in a TOML file instead (--setup FILE.toml), as one line for each column: indenter_shape = "flat"
trial_id,site,subject,t_s,indentation_mm,force_N,indenter_shape,indenter_size_mm,along_mm,across_mm,tilt_deg
"""

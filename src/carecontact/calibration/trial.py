"""One measured press, in SI units."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
PHASES = ("load", "hold", "unload")
SHAPES = ("flat", "hemisphere", "cap")


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
    """(n,) increasing"""
    indentation_m: Array
    """(n,) as recorded; the user chose its zero"""
    force_n: Array
    """(n,) as recorded, compression positive"""
    phase: npt.NDArray[np.int64]
    """(n,) index into PHASES"""
    line: int
    """Line of its first row in the file."""

    @property
    def unloads(self) -> bool:
        return int((self.phase == PHASES.index("unload")).sum()) >= 5

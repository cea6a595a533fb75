"""Trial files written past the writer's checks, with a checksum that holds."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import numpy.typing as npt

from carecontact.recording.file import canonical_digest


def store(path: Path, header: object, arrays: Mapping[str, npt.NDArray[Any]]) -> Path:
    """``header`` as JSON may have it; ``bytes`` are stored as they are."""
    content = header if isinstance(header, bytes) else json.dumps(header).encode()
    with h5py.File(path, "w") as file:
        file["header_json"] = np.frombuffer(content, np.uint8)
        file["sha256"] = np.frombuffer(bytes.fromhex(canonical_digest(content, arrays)), np.uint8)
        for name, array in arrays.items():
            file[name] = array
    return path

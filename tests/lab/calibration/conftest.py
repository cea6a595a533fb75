from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

ROOT = Path(__file__).parents[3]


@pytest.fixture(scope="session")
def generator() -> ModuleType:
    """tools/make_synthetic_trials.py as a module."""
    spec = importlib.util.spec_from_file_location("make_synthetic_trials", ROOT / "tools" / "make_synthetic_trials.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def analytic_csv(generator: ModuleType, tmp_path: Path) -> Path:
    path = tmp_path / "trials.csv"
    generator.make("forearm", "analytic", path, seed=5)
    return path


HEADER = (
    "trial_id,site,subject,t_s,indentation_mm,force_N,phase,speed_mm_s,indenter_shape,indenter_size_mm,preload_N,filter"
)


def rows(
    trial: str = "a",
    *,
    n: int = 60,
    speed: float = 5.0,
    depth: float = 4.0,
    site: str = "forearm",
    shape: str = "hemisphere",
    unload: bool = False,
) -> list[str]:
    """A press of 1 N/mm without noise, 1 mm of free motion before it."""
    travel = np.linspace(-1.0, depth, n)
    out = [
        f"{trial},{site},p1,{(d + 1) / speed:.6f},{d:.5f},{max(d, 0.0):.5f},load,{speed:g},{shape},10,0,none"
        for d in travel
    ]
    if unload:
        out += [
            f"{trial},{site},p1,{(2 * depth + 1 - d + 0.01) / speed:.6f},{d:.5f},{0.8 * max(d, 0.0):.5f},unload,"
            f"{speed:g},{shape},10,0,none"
            for d in travel[::-1]
        ]
    return out


def save(path: Path, lines: list[str], *, header: str = HEADER) -> Path:
    path.write_text("\n".join([header, *lines]) + "\n")
    return path

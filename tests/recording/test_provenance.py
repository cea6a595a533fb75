from __future__ import annotations

import platform
from typing import Any

import numpy as np
import pytest

from carecontact.recording.provenance import arithmetic


def row(api: str, package: str, **facts: str) -> dict[str, Any]:
    return {"user_api": api, "internal_api": "openblas", "filepath": f"/site/{package}.libs/lib.so", **facts}


def loaded(monkeypatch: pytest.MonkeyPatch, *rows: dict[str, Any]) -> str:
    monkeypatch.setattr("threadpoolctl.threadpool_info", lambda: list(rows))
    return arithmetic().split(" on ")[0]


def test_it_names_the_processors_family_linear_algebra_and_the_c_library() -> None:
    assert np.ones(2) @ np.ones(2) == 2.0  # numpy's library is loaded
    algebra, rest = arithmetic().split(" on ")
    assert algebra == "unknown linear algebra" or len(algebra.split(" ")) == 3
    assert rest == f"{platform.machine()} with {' '.join(platform.libc_ver()).strip() or 'an unknown C library'}"


def test_numpys_library_counts_among_several(monkeypatch: pytest.MonkeyPatch) -> None:
    omp = row("openmp", "numpy", version="5")
    scipy = row("blas", "scipy", version="0.3.30", architecture="Zen")
    numpy = row("blas", "numpy", version="0.3.31", architecture="SkylakeX")
    assert loaded(monkeypatch, omp, scipy, numpy) == "openblas 0.3.31 SkylakeX"
    assert loaded(monkeypatch, omp, scipy) == "openblas 0.3.30 Zen"


def test_what_is_not_known_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    assert loaded(monkeypatch) == "unknown linear algebra"
    assert loaded(monkeypatch, row("blas", "numpy", version="3")) == "openblas 3"
    monkeypatch.setattr("platform.libc_ver", lambda: ("", ""))
    assert arithmetic().endswith(" with an unknown C library")

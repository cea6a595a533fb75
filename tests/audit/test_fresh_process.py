from __future__ import annotations

from pathlib import Path

import pytest

from carecontact.audit import fresh_process
from carecontact.errors import CarecontactError

SAYS = (
    "import json, os, sys; print('a line'); print(json.dumps({'got': sys.argv[2], 'gl': os.environ.get('MUJOCO_GL')}))"
)


def test_the_last_line_is_what_it_says(tmp_path: Path) -> None:
    said = fresh_process.said_by(SAYS, tmp_path, environment={"MUJOCO_GL": "egl"})
    assert said == {"got": str(tmp_path), "gl": "egl"}


def test_what_breaks_or_hangs_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(CarecontactError, match="ended with status 1: no such luck"):
        fresh_process.said_by("raise SystemExit('no such luck')", tmp_path)
    monkeypatch.setattr(fresh_process, "LONGEST_S", 0.2)
    with pytest.raises(CarecontactError, match=r"did not end within 0\.2 s"):
        fresh_process.said_by("import time; time.sleep(60)", tmp_path)

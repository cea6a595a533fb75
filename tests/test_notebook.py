"""The notebook of the first hour, whose code runs as one script in a new process."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

CELLS = json.loads((Path(__file__).parents[1] / "examples/first_hour.ipynb").read_text())["cells"]
CODE = ["".join(cell["source"]) for cell in CELLS if cell["cell_type"] == "code"]


def test_it_is_short_stored_without_outputs_and_compiles() -> None:
    assert len(CELLS) <= 12
    assert all((cell["outputs"], cell["execution_count"]) == ([], None) for cell in CELLS if "outputs" in cell)
    for code in CODE:
        compile(code, "cell", "exec")


@pytest.mark.slow
def test_its_code_runs_to_a_comparison(tmp_path: Path) -> None:
    script = tmp_path / "notebook.py"
    script.write_text("\n".join(CODE))
    done = subprocess.run([sys.executable, script.name], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    rows = [line.split() for line in done.stdout.splitlines()]
    assert [row[1] for row in rows if row[0] in ("first_policy:Reach", "state-machine")] == ["T1-s000", "T1-s001"] * 2
    assert "process_failure" not in done.stdout
    assert any(row[0] == "Safety-gated" for row in rows), done.stdout

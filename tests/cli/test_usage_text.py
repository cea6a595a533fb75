"""tyro draws its box with other characters where the terminal has no UTF-8; the line that comes out is the same."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

TOLD = {
    ("run", "--policy", "hover"): (
        "error: Missing from carecontact run: --out PATH; For full helptext, run: carecontact run --help\n"
    ),
    ("run", "a:B"): (
        "error: no option takes a:B (did you mean --policy a:B?); Missing from carecontact run: --policy STR --out "
        "PATH; For full helptext, run: carecontact run --help\n"
    ),
    ("protocol", "sho"): (
        "error: no choice named 'sho' (did you mean 'show'?); "
        "valid: list, show, verify, lock, feasible; For full helptext, "
        "run carecontact protocol --help\n"
    ),
    (
        "demo",
        "--jobs",
        "two",
    ): "error: --jobs: expected INT, got 'two'; For full helptext, see carecontact demo --help\n",
    ("serve", "hover", "--port", "x"): (
        "error: --port: expected INT, got 'x'; For full helptext, see carecontact serve --help\n"
    ),
    ("run", "--policy", "hover", "--out", "r", "--tasks", "T1", "T2"): (
        "error: no option takes T2 (did you mean a list with commas, such as --tasks T1,T2 or --seeds 0,1?); For full "
        "helptext, run carecontact run --help\n"
    ),
    ("doctor", "x"): "error: no option takes x; For full helptext, run carecontact doctor --help\n",
}


@pytest.mark.parametrize("encoding", ["utf-8", "ascii"])
@pytest.mark.parametrize("arguments", TOLD)
def test_a_wrong_command_line_is_one_line_in_every_encoding(arguments: tuple[str, ...], encoding: str) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "carecontact", *arguments],
        env={**os.environ, "PYTHONIOENCODING": encoding},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.stderr == TOLD[arguments]

"""The commands of docs/pi05.md, against a stand-in where the page has a machine with a GPU."""

from __future__ import annotations

import json
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from carecontact.cli.commands import parse
from tests.hosting.dialects.fakes import Openpi, OpenpiPositions

PAGE = (Path(__file__).parents[1] / "docs" / "pi05.md").read_text(encoding="utf-8").replace("\\\n", " ")
COMMANDS = [
    shlex.split(line)[1:]
    for block in re.findall(r"^```sh\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)
    for line in block.splitlines()
    if line.startswith("carecontact ")
]
RUNS = [command for command in COMMANDS if command[0] == "run"]


def test_the_page_has_a_run_of_each_profile_and_a_check() -> None:
    assert {command[0] for command in COMMANDS} == {"run", "check"}
    for profile in ("pi05-droid", "pi05-droid-jointpos"):
        assert any(f"openpi://GPU-HOST:8000?profile={profile}" in command for command in RUNS)


@pytest.mark.parametrize("command", COMMANDS, ids=" ".join)
def test_every_command_is_understood(command: list[str]) -> None:
    assert type(parse(command)).__name__.lower() == command[0]


@pytest.mark.parametrize("command", RUNS, ids=" ".join)
def test_every_run_completes_a_short_trial(command: list[str], tmp_path: Path) -> None:
    server = OpenpiPositions() if "jointpos" in " ".join(command) else Openpi(steps=15)
    with server.running() as port:
        here = [part.replace("GPU-HOST:8000", f"127.0.0.1:{port}") for part in command]
        short = ["--tasks", "T1", "--seeds", "0", "--set", "phases.time_limit_s=1.5"]
        done = subprocess.run(
            [sys.executable, "-m", "carecontact", *here, *short], cwd=tmp_path, capture_output=True, text=True
        )
    assert done.returncode == 0, done.stdout + done.stderr
    out = tmp_path / command[command.index("--out") + 1]
    (trial,) = json.loads((out / "results.json").read_text())["trials"]
    assert trial["ended"] == "time_limit"
    late = "--latency-ms" in command
    assert ("phases.latency_s" in trial.get("overrides", {})) is late

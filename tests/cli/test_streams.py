from __future__ import annotations

import os
import pty
import subprocess
import sys
from pathlib import Path

GOES_ON = """
import sys
from pathlib import Path
from carecontact.cli.streams import prepare_streams
prepare_streams()
print("begun", flush=True)
sys.stdin.readline()
for stream in (sys.stdout, sys.stderr):
    for text in ("one", "\\ud800", "x" * 100_000):
        print(text, file=stream, flush=True)
Path("done").touch()
"""


def test_a_command_outlives_its_terminal(tmp_path: Path) -> None:
    ours, theirs = pty.openpty()
    with subprocess.Popen(
        [sys.executable, "-c", GOES_ON], cwd=tmp_path, stdin=subprocess.PIPE, stdout=theirs, stderr=theirs
    ) as command:
        os.close(theirs)
        assert os.read(ours, 100) == b"begun\r\n"
        os.close(ours)
        command.communicate(b"\n", timeout=60)
    assert (command.returncode, (tmp_path / "done").exists()) == (0, True)

"""``carecontact serve`` in a process of its own, for tests of the other end."""

from __future__ import annotations

import subprocess
import sys
import textwrap
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from tests.serving.conftest import PREAMBLE

WITHOUT_WAITING = 1e9
"""In place of the first pause [s] of ``serving.opening``: longer than any deadline, so that no call waits for a server
that is away."""


@contextmanager
def served(
    source: str, folder: Path, *, at_once: int = 2, port: int = 0
) -> Iterator[tuple[int, subprocess.Popen[str]]]:
    """Port and process of a server of class P of a module with that source. ``port`` 0: one that is free."""
    (folder / "under_test.py").write_text(PREAMBLE + textwrap.dedent(source))
    options = ["--port", str(port), "--at-once", str(at_once)]
    command = [sys.executable, "-m", "carecontact", "serve", "under_test:P", *options]
    server = subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    assert server.stdout is not None
    try:
        line = server.stdout.readline()
        assert line.startswith("under_test:P: serving on 127.0.0.1, port "), line + server.stdout.read()
        yield int(line.split()[-1]), server
    finally:
        server.terminate()
        server.wait(20)
        server.stdout.close()

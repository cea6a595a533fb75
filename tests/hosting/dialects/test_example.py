"""examples/openpi_server.py, run as its first lines say."""

from __future__ import annotations

import subprocess
import sys
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from carecontact.errors import PolicyError
from tests.hosting.dialects.talking import joints, talk

EXAMPLE = Path(__file__).parents[3] / "examples" / "openpi_server.py"


@pytest.fixture(scope="module")
def port() -> Iterator[int]:
    with subprocess.Popen([sys.executable, EXAMPLE, "0"], stdout=subprocess.PIPE, text=True) as server:
        assert server.stdout is not None
        yield int(server.stdout.readline().split()[-1])
        server.terminate()


def test_it_answers_a_chunk_of_15_of_which_8_are_executed(port: int) -> None:
    executed = joints(talk(f"openpi://127.0.0.1:{port}?profile=pi05-droid", calls=2))
    expected = np.zeros((16, 7))
    expected[:, 5] = np.float32(0.05)
    np.testing.assert_array_equal(executed, expected)


def test_it_tells_its_errors_and_its_health(port: int) -> None:
    with pytest.raises(PolicyError, match=r"KeyError: 'observation/exterior_image_1_left'") as caught:
        talk(f"openpi://127.0.0.1:{port}?profile=pi05-droid&exterior=0")
    assert caught.value.kind == "exception"
    with urllib.request.urlopen(f"http://127.0.0.1:{port}/healthz") as answer:
        assert answer.read() == b"OK\n"


def test_it_needs_no_package_of_carecontact() -> None:
    assert "carecontact" not in [
        line for line in EXAMPLE.read_text().splitlines() if line.startswith(("import", "from"))
    ]
    assert len(EXAMPLE.read_text().splitlines()) < 70

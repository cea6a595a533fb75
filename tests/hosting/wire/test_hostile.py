"""Whatever a peer does on its line, each call ends in time, as a failure that has a name."""

from __future__ import annotations

import json
import subprocess
import sys
import tracemalloc
from collections.abc import Callable

import pytest

from carecontact.errors import PolicyError
from carecontact.hosting.wire.packing import MAX_REPLY_BYTES
from tests.hosting.wire.hostile import STAGES, attacks_at, hostile_server
from tests.hosting.wire.hostile_client import DEADLINE_S, meet

LATE_S, MEMORY_MB = 2.0, 256
AT_ONCE = 24
"""Most of the attacks wait for a deadline, so that many can be met at the same time."""


@pytest.mark.parametrize("times", [1, pytest.param(10, marks=pytest.mark.slow)])
def test_every_call_ends_in_time_and_names_the_failure(
    times: int, record_property: Callable[[str, object], None]
) -> None:
    with hostile_server() as port:
        command = [sys.executable, "-m", "tests.hosting.wire.hostile_client", *map(str, (port, times, AT_ONCE))]
        done = subprocess.run(command, stdout=subprocess.PIPE, check=True, timeout=120 * times)
    found = json.loads(done.stdout)
    assert len(found["met"]) == times * sum(len(attacks_at(stage)) for stage in STAGES)
    late = [row for row in found["met"] if row[3] > DEADLINE_S + LATE_S]
    assert not late
    unnamed = [
        row for row in found["met"] if row[2] not in (*PolicyError.KINDS, *([None] if row[0] == "close" else []))
    ]
    assert not unnamed
    # A peer whose handshake never ends reaches no stage behind it.
    for stage in ("card", "reset", "act"):
        assert {row[2] for row in found["met"] if row[0] == stage} >= {"died", "garbage", "oversize", "timeout"}
    peak_mb = max(row[4] for row in found["met"])
    assert peak_mb < MEMORY_MB
    record_property("met", len(found["met"]))
    record_property("slowest", max(row[3] for row in found["met"]))
    record_property("peak_mb", peak_mb)


def test_a_flood_of_large_messages_is_not_kept() -> None:
    with hostile_server() as port:
        tracemalloc.start()
        try:
            assert meet(port, "card", "large-message-flood")[2] == "garbage"
            peak = tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()
    assert peak < 8 * MAX_REPLY_BYTES

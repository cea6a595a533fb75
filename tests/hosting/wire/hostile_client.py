"""The harness's end against the hostile peer, in a process whose memory is measured.

``python -m tests.hosting.wire.hostile_client PORT TIMES AT_ONCE`` meets each attack at each stage that often and prints
a JSON object: ``met``, rows of stage, attack, kind of the failure or null, and seconds of the attacked call; and
``peak_mb``, of memory.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from carecontact.errors import PolicyError
from carecontact.hosting.client import Client
from carecontact.hosting.remote import RemotePolicy
from carecontact.hosting.setup import PolicySetup
from carecontact.hosting.wire.client import PolicyClient
from carecontact.hosting.wire.connection import Connection
from tests.hosting.wire.hostile import STAGES, attacks_at
from tests.policies.synthetic import SESSION, synthetic_observation, synthetic_view

DEADLINE_S = 1.5

Row = tuple[str, str, str | None, float]


class Attacked(RemotePolicy):
    """The address of the native wire has no path."""

    path = "/"

    def _open(self, left: Callable[[], float]) -> Client:
        return PolicyClient(Connection.open(port=self._ref.port, path=self.path, deadline_s=left()))


def meet(port: int, stage: str, attack: str) -> Row:
    """A trial's conversation up to the failure, and how long the call took that was attacked."""
    setup = PolicySetup.of(f"ws://127.0.0.1:{port}")
    policy = Attacked(setup, first_deadline_s=DEADLINE_S, deadline_s=DEADLINE_S)
    policy.path = f"/{stage}/{attack}"
    # Larger than what the kernel takes off the sender's hands.
    seen = synthetic_observation(cameras={"overhead": synthetic_view(height=480, width=640)})
    kind, began = None, time.monotonic()
    try:
        policy.start()
        began = time.monotonic()
        policy.reset("touch", SESSION)
        began = time.monotonic()
        policy.act(seen)
        began = time.monotonic()
    except PolicyError as error:
        kind = error.kind
    policy.close()
    return stage, attack, kind, time.monotonic() - began


def main(port: int, times: int, at_once: int) -> None:
    plan = [(stage, attack) for _ in range(times) for stage in STAGES for attack in attacks_at(stage)]
    with ThreadPoolExecutor(at_once) as pool:
        met = list(pool.map(lambda case: meet(port, *case), plan))
    # Not ru_maxrss: that begins with the memory of the process that started this one.
    (peak_kb,) = [line.split()[1] for line in Path("/proc/self/status").read_text().splitlines() if "VmHWM" in line]
    peak_mb = int(peak_kb) / 1024
    sys.stdout.write(json.dumps({"met": met, "peak_mb": peak_mb}))


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))

"""The harness's end against the hostile peer, in processes whose memory is measured.

``python -m tests.serving.hostile_client PORT TIMES AT_ONCE`` meets each attack at each stage that often, in
AT_ONCE processes with one connection each, as a trial has. It prints a JSON object: ``met``, rows of stage, attack,
kind of the failure or null, seconds of the attacked call, and the largest memory [MB] of its process so far.
"""

from __future__ import annotations

import json
import multiprocessing
import sys
import time
from collections.abc import Callable
from pathlib import Path

from carecontact.errors import PolicyError
from carecontact.serving.client import Client, PolicyClient
from carecontact.serving.connection import Connection
from carecontact.serving.conversation import PolicySetup
from carecontact.serving.opening import RemotePolicy
from tests.policies.synthetic import SESSION, synthetic_observation, synthetic_view
from tests.serving.hostile import STAGES, attacks_at

DEADLINE_S = 1.5

Row = tuple[str, str, str | None, float, float]


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
    took_s = time.monotonic() - began
    return stage, attack, kind, took_s, memory_mb()


def memory_mb() -> float:
    """Not ru_maxrss: that begins with the memory of the process that started this one."""
    status = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in status if "VmHWM" in line) / 1024


def main(port: int, times: int, at_once: int) -> None:
    plan = [(port, stage, attack) for _ in range(times) for stage in STAGES for attack in attacks_at(stage)]
    # Forked, so that nothing is imported again.
    with multiprocessing.get_context("fork").Pool(at_once) as pool:
        met = pool.starmap(meet, plan, chunksize=1)
    sys.stdout.write(json.dumps({"met": met}))


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))

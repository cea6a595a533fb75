"""What the isolation of a policy's process costs, as JSON on standard output.

    python benchmarks/isolation.py [--policy hover] [--pairs 100]

A trial starts its policy's process once. Each pair starts one with and one without isolation, in turns first, resets
it, gets one answer and closes it. Wall time, and processor time of this process and of the policy's: medians [ms], and
the median of the differences within the pairs with its 95 % interval, by order statistics.
"""

from __future__ import annotations

import argparse
import json
import resource
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from math import sqrt
from statistics import median

from carecontact.serving.conversation import PolicySetup
from carecontact.serving.opening import open_policy
from some_session import SESSION, observation

SEEN = observation()


def processor_s() -> float:
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(each.ru_utime + each.ru_stime for each in used)


def once(setup: PolicySetup) -> tuple[float, float, str]:
    """Wall time and processor time of one start [s], and the level of isolation."""
    began, used = time.perf_counter(), processor_s()
    with open_policy(setup, first_deadline_s=60.0, deadline_s=60.0) as policy:
        policy.start()
        policy.reset(SEEN.instruction, SESSION)
        policy.act(SEEN)
        level = str(policy.isolation)
        policy.close()
    return time.perf_counter() - began, processor_s() - used, level


def summary(with_s: Sequence[float], without_s: Sequence[float]) -> dict[str, object]:
    differences = sorted(1000 * (a - b) for a, b in zip(with_s, without_s, strict=True))
    n = len(differences)
    reach = round(1.96 * sqrt(n) / 2)
    low, high = differences[max(n // 2 - reach, 0)], differences[min(n // 2 + reach, n - 1)]
    return {
        "with_ms": round(1000 * median(with_s), 1),
        "without_ms": round(1000 * median(without_s), 1),
        "difference_ms": round(median(differences), 1),
        "interval_ms": [round(low, 1), round(high, 1)],
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--policy", default="hover")
    parser.add_argument("--pairs", type=int, default=100)
    given = parser.parse_args()
    closed = PolicySetup.of(given.policy)
    setups = {True: closed, False: replace(closed, isolated=False)}
    took: dict[bool, list[tuple[float, float, str]]] = {True: [], False: []}
    for number in range(-2, given.pairs):
        for isolated in (True, False) if number % 2 else (False, True):
            found = once(setups[isolated])
            if number >= 0:  # the first ones fill the file cache
                took[isolated].append(found)
    out: dict[str, object] = {"policy": given.policy, "pairs": given.pairs, "level": took[True][0][2]}
    out["wall"] = summary(*([wall_s for wall_s, _, _ in took[isolated]] for isolated in (True, False)))
    out["processor"] = summary(*([used_s for _, used_s, _ in took[isolated]] for isolated in (True, False)))
    sys.stdout.write(json.dumps(out, indent=2) + "\n")


if __name__ == "__main__":
    main()

"""A hundred trials of all tasks, levels and bodies begin again to the last bit, and 500 resets leave nothing behind."""

from __future__ import annotations

import ctypes
import gc
import threading
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import numpy as np
import psutil
import pytest

from carecontact.episode.episode import Episode
from carecontact.episode.perception import Peak
from carecontact.episode.worlds import Worlds
from carecontact.interface.action import Action
from carecontact.interface.policy import PolicyCard
from carecontact.protocol.load import load_protocol
from carecontact.protocol.protocol import TrialSpec
from carecontact.recording import canonical_hash
from carecontact.serving.codec import observation_sha256
from tests.episode.test_worlds import BLIND, JOINTS, SEEING, roll, touched

LEVELS = ("L0", "L1", "L2", "L3")
DRAWS = 100
LOOKING = PolicyCard(name="looking", modalities=("rgb", "landmarks", "masks"), cameras=("overhead",), control_hz=10)


def draws(count: int) -> Iterator[TrialSpec]:
    """Levels and tasks in turn; nine seeds in a row have all nine bodies."""
    for number in range(count):
        protocol = load_protocol("bathing-wide-v2", level=LEVELS[number % len(LEVELS)])
        task = protocol.tasks[number % len(protocol.tasks)].id
        yield TrialSpec(protocol=protocol, task_id=task, seed=number % 27, policy="draws", noise_salt="one")


@pytest.mark.slow
def test_every_drawn_trial_begins_again_as_a_new_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Peak, "pictures", lambda self, renderer, region: {})
    worlds, bodies, contacts = Worlds(3), set[str](), 0
    for number, spec in enumerate(draws(DRAWS)):
        card = (SEEING, BLIND, BLIND, JOINTS)[number // 7 % 4]
        with Episode(spec, card=card, digest=observation_sha256) as new:
            first = roll(new, actions=90)
        with Episode(spec, card=card, worlds=worlds, digest=observation_sha256) as kept:
            roll(kept, actions=10 + number % 50)
            again = roll(kept, actions=90)
        assert canonical_hash(first) == canonical_hash(again), f"{spec.protocol.name} {spec.trial_id} {card.name}"
        bodies.add(first.header.body)
        contacts += touched(first)
    assert len(bodies) == 9
    assert contacts > DRAWS / 2


def use_of_resets(card: PolicyCard) -> tuple[list[int], list[int]]:
    """Return the memory [B] and the number of threads of this process after every hundred of 600 resets but the first.
    Half of the trials are kept, and a twentieth is built anew."""
    process, rss, threads = psutil.Process(), list[int](), list[int]()
    protocol = load_protocol("bathing-wide-v2", level="L1")
    specs = [TrialSpec(protocol=protocol, task_id="T1", seed=seed, policy="leaks") for seed in range(3)]
    order = np.random.default_rng(0)
    with Episode(specs[0], card=card, worlds=Worlds(1), record=False) as episode:
        for number in range(600):
            # Two of the three worlds fit: one in use and one that is kept.
            spec = specs[order.integers(3)] if number % 10 == 0 else episode.spec
            look = episode.reset(spec)
            episode.step(Action(pose_tcp_in_base=look.pose_tcp_in_base))
            if number >= 100 and number % 100 == 99:
                gc.collect()
                # What was freed, but kept by the allocator, is no leak.
                ctypes.CDLL("libc.so.6").malloc_trim(0)
                rss.append(process.memory_info().rss)
                threads.append(threading.active_count() + process.num_threads())
    return rss, threads


@pytest.mark.slow
@pytest.mark.parametrize("card", [SEEING, LOOKING], ids=lambda card: card.name)
def test_five_hundred_resets_leak_nothing(card: PolicyCard) -> None:
    """In a process of its own, whose memory depends on no other test; the renderers of worlds that go are closed."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        rss, threads = pool.submit(use_of_resets, card).result()
    assert len(set(threads)) == 1, threads
    # The allocator settles within the first hundreds; a renderer is 10 MiB and a world more.
    assert max(rss[2:]) - rss[1] < 30 << 20, [round(size / 2**20) for size in rss]

"""What a seed decides. Named streams, so that adding one never changes another."""

from __future__ import annotations

import hashlib

import numpy as np

from carecontact.contract.protocol import Protocol

STREAMS = ("comfort_arm", "appearance", "sensor_noise", "policy")


def streams(protocol: Protocol, seed: int) -> dict[str, np.random.Generator]:
    """One generator a stream; they depend on protocol id and seed only, so trials are paired over tasks and methods."""
    words = np.frombuffer(hashlib.sha256(protocol.id.encode()).digest(), "<u4").tolist()
    children = np.random.SeedSequence([*words, seed]).spawn(len(STREAMS))
    return {name: np.random.default_rng(child) for name, child in zip(STREAMS, children, strict=True)}


def comfort_arm_deg(protocol: Protocol, seed: int) -> float:
    low, high = protocol.randomization.comfort_arm_deg
    return float(streams(protocol, seed)["comfort_arm"].uniform(low, high))

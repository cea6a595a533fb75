"""Whether a blanked input changes what a policy answers, beyond what repeats of one request differ by themselves."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

F64 = npt.NDArray[np.float64]

SHUFFLES = 999
SEEN_P = 0.05
"""An effect counts as seen below this probability. It is also the share of inputs without effect that go unnoticed."""
NEIGHBOURS = 3


def differ_p(plain: F64, blanked: F64, rng: np.random.Generator) -> float:
    """Return the probability of a difference at least as large as this one if the input has no effect.

    A permutation test, which assumes nothing about the answers but that calls with and without the input were made in
    random order. It combines three statistics: the squared difference of the means over all numbers of the answer, for
    an effect on many of them; the largest difference of a mean, for an effect on one; and how often the nearest
    answers are of the same kind, for an answer that has several modes.

    Args:
        plain: (n, D) numbers of the answers to one request.
        blanked: (m, D) of those to the same request with one input blanked.
    """
    values = np.concatenate([plain, blanked])
    spread = values.std(axis=0)
    values = values[:, spread > 0] / spread[spread > 0]
    if not values.size:
        return 1.0
    n, total = len(plain), len(values)
    labels = np.zeros((SHUFFLES + 1, total))
    labels[0, :n] = 1
    labels[1:] = rng.permuted(np.tile(labels[0], (SHUFFLES, 1)), axis=1)
    means = labels @ values / n - (1 - labels) @ values / (total - n)
    far = ((values[:, None] - values[None]) ** 2).sum(-1)
    np.fill_diagonal(far, np.inf)
    near = np.argsort(far, axis=1, kind="stable")[:, :NEIGHBOURS]
    same = (labels[:, near] == labels[:, :, None]).sum((1, 2))
    ranks = [_share_at_least(statistic) for statistic in ((means**2).sum(1), np.abs(means).max(1), same.astype(float))]
    best = np.min(ranks, axis=0)
    return float((best <= best[0] + 1e-12).mean())


def _share_at_least(statistic: F64) -> F64:
    """(shuffles,) share of all shuffles whose statistic is at least that of each."""
    rounded = np.round(statistic, 9)
    return (len(rounded) - np.searchsorted(np.sort(rounded), rounded, side="left")) / len(rounded)

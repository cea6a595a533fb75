"""Whether a blanked input changes a policy's answers by more than repeats of one request differ."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

F64 = npt.NDArray[np.float64]

SHUFFLES = 999
SEEN_P = 0.05
"""An effect counts as seen below this probability, which is also the share of inputs without effect that are mistaken
for inputs with one."""
NEIGHBOURS = 3


def differ_p(plain: F64, blanked: F64, rng: np.random.Generator) -> float:
    """Return the probability of a difference at least as large as this one if the input has no effect.

    This is a permutation test, which assumes only that calls with and without the input were made in random order. It
    combines three statistics: the squared difference of the means over all numbers of the answer, for an effect on many
    of them; the largest difference of a mean, for an effect on one; and how often the nearest answers are of the same
    kind, for answers with several modes.

    Args:
        plain: (n, D) numbers of the answers to one request.
        blanked: (m, D) numbers of the answers to the same request with one input blanked.
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
    """Return, for each shuffle (shuffles,), the share of all shuffles with a statistic at least as large."""
    rounded = np.round(statistic, 9)
    return (len(rounded) - np.searchsorted(np.sort(rounded), rounded, side="left")) / len(rounded)

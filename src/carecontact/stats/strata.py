"""Resamples of persons, where each stratum keeps its share of them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Hashable, Mapping, Sequence

import numpy as np
import numpy.typing as npt

from carecontact.errors import counted

GENERATOR_SEED = 20260
RESAMPLES = 10_000
Floats = npt.NDArray[np.float64]


def stratified_weights(
    strata: Sequence[Hashable], *, resamples: int = RESAMPLES, generator_seed: int = GENERATOR_SEED
) -> Floats:
    """(R, K) how much each of K persons counts in each resample; each row adds up to K.

    Of a stratum's n persons, n - 1 are drawn with replacement and count n / (n - 1) each: the bootstrap of Rao and Wu,
    JASA 83:231 (1988), whose variance is unbiased also for strata of two or three. Drawing n of n would give two
    thirds of the variance for three. Strata with a single person are taken together, which makes the interval rather
    too wide (collapsed strata: Cochran, Sampling Techniques, 1977, 5A.12); a last one alone joins the largest stratum.

    Args:
        strata: (K,) of each person, such as the body.

    Raises ValueError for fewer than two persons or resamples < 1.
    """
    if len(strata) < 2:
        raise ValueError(f"{counted(len(strata), 'person')}; expected at least 2")
    if resamples < 1:
        raise ValueError(f"resamples = {resamples}; expected at least 1")
    generator = np.random.default_rng(generator_seed)
    weights = np.zeros((resamples, len(strata)))
    for members in _groups(strata):
        n = len(members)
        drawn = generator.multinomial(n - 1, np.full(n, 1.0 / n), size=resamples)
        weights[:, members] = drawn * (n / (n - 1))
    return weights


def strata_of(names: Sequence[int], strata: Mapping[int, Hashable] | None) -> list[Hashable]:
    """Return the stratum of each person; without strata all are in one. Raises ValueError for a person that has
    none."""
    if strata is None:
        return [0] * len(names)
    missing = [name for name in names if name not in strata]
    if missing:
        raise ValueError(f"person {missing[0]} has no stratum; expected one for each")
    return [strata[name] for name in names]


def _groups(strata: Sequence[Hashable]) -> list[list[int]]:
    """Indices of the persons of each stratum, two or more in each."""
    size = Counter(strata)
    alone = [i for i, stratum in enumerate(strata) if size[stratum] == 1]
    groups = [[i for i, s in enumerate(strata) if s == stratum] for stratum, n in size.items() if n > 1]
    if len(alone) == 1:
        largest = max(range(len(groups)), key=lambda g: len(groups[g]))
        groups[largest] = sorted(groups[largest] + alone)
    elif alone:
        groups.append(alone)
    return groups

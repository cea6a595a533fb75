"""Tests whether two methods differ, person by person."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, kw_only=True)
class SignFlip:
    pvalue: float | None
    """Two-sided, exact; 1 if all differences are 0, None without persons."""
    n: int
    """Persons."""
    n_unequal: int
    """Number of persons with a difference; only these decide."""


def sign_flip(differences: Sequence[int]) -> SignFlip:
    """Exact permutation test of whole persons (Fisher, The Design of Experiments, 1935, 21).

    Under the null hypothesis either method could have had either result on a person, so each difference has either sign
    with 1/2, all tasks of the person together. The p-value is the probability of a sum at least as far from 0, found by
    adding person after person. With one trial a person, it is McNemar's exact test. Raises ValueError for a difference
    that is no whole number.

    Args:
        differences: (K,) of each person: trials that the first method passed minus those that the second did.
    """
    whole = [int(value) for value in differences]
    if any(a != b for a, b in zip(whole, differences, strict=True)):
        raise ValueError("a difference is no whole number; expected counts of trials")
    sizes = [abs(value) for value in whole if value]
    if not sizes:
        return SignFlip(pvalue=1.0 if whole else None, n=len(whole), n_unequal=0)
    total = sum(sizes)
    probability = np.zeros(total + 1)  # of the sum of those with a plus
    probability[0] = 1.0
    for size in sizes:
        shifted = np.zeros_like(probability)
        shifted[size:] = probability[:-size]
        probability = (probability + shifted) / 2
    distance = np.abs(2 * np.arange(total + 1) - total)
    return SignFlip(
        pvalue=min(1.0, float(probability[distance >= abs(sum(whole))].sum())), n=len(whole), n_unequal=len(sizes)
    )

"""Counts and medians over trials, as `results.json` has them (docs/scoring.md)."""

from __future__ import annotations

from carecontact.cli.answers.answer import Part
from carecontact.stats import Median


class Rate(Part):
    n: int
    """Number of trials that count."""
    pc: float | None
    """Rate [percent]; null if no trial counts, and for an incomplete run."""
    pc_between: tuple[float, float]
    """Rate [percent] if all planned trials without a verdict failed, and if all of them passed."""
    pc_ci95: tuple[float, float]
    """Wilson's 95 % interval [percent]; for an incomplete run, it covers both of these."""


class Exceedance(Rate):
    n_success: int
    """Number of these trials that are successful."""


class Summary(Part):
    """Counts and medians over the trials with a verdict."""

    n_planned: int
    """Planned trials; more than ``n_episodes`` where the run is incomplete."""
    n_episodes: int
    """Trials with a verdict."""
    n_success: int
    pc_success: float | None
    pc_success_between: tuple[float, float]
    pc_success_ci95: tuple[float, float]
    region_correct: Rate
    safety_gated: Rate
    valid_contact: Rate
    valid_ratio: Rate
    """Share of the trials that have a trajectory to score."""
    exceedances: dict[str, Exceedance]
    """``gate`` and ``pain`` -> number of trials with a force above that limit."""
    quadrants: dict[str, int]
    medians: dict[str, Median]
    """Column of the table, with the trials over which it is pooled -> median."""
    additional: dict[str, Median]
    """Id of a further metric -> median."""
    anatomy: dict[str, int]
    failure_modes: dict[str, int]
    attributions: dict[str, int]

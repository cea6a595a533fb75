"""Whether a calibration is good enough for runs: limits on held-out errors, and what its data cannot be right in."""

from __future__ import annotations

from collections.abc import Iterator

from carecontact.calibration.certificate import Content
from carecontact.errors import ConfigError, counted

LIMITS = {"nrmse": 0.05, "tangent_error": 0.05, "work_error": 0.10}
"""Largest pooled errors on held-out trials that are accepted; ``tests/calibration/test_proof.py`` holds the fit to the
same limits."""
NAMES = {"nrmse": "NRMSE", "tangent_error": "tangent stiffness", "work_error": "total work lost"}
PUBLISHED = (0.25, 6.0)
"""Measured force over that of published tissue under the same press: outside, the unit is more likely wrong than the
tissue that different. The shipped manikin-like tissue is up to 4.8 times as stiff as the published one."""
REPLAYABLE = (0.08, 25.0)
"""Outside, no anchors reproduce the forces: the contact layer in front of them is about 30 times as stiff as published
anchors, and ``Tissue`` refuses anchors below a 300th of it."""
ROUNDING = 1e-9


def check_replayable(ratio: float, region: str) -> None:
    """Raise ConfigError if the measured forces are ``ratio`` times published ones and no tissue can have them."""
    low, high = REPLAYABLE
    if not low <= ratio <= high:
        raise ConfigError(
            f"column force_N: {_of_published(ratio, region)}; is it in newtons, and not in grams, volts or "
            "millinewtons? Multiply the column, or write its unit in the header, such as Force [mN]"
        )


def reasons(content: Content) -> list[str]:
    """Return why the calibration is rejected, one sentence each, causes first; none if it is accepted."""
    return [
        *_implausible(content),
        *_beyond_limits(content),
        *(
            f"the estimate of {name} is {value.value:.4g} and lies outside its own interval, {value.ci95[0]:.4g} to "
            f"{value.ci95[1]:.4g}: the fit is not one that resampled trials would give"
            for name, value in {**content.law, **content.stiffness}.items()
            if value.value is not None and value.ci95 is not None and not _inside(value.value, value.ci95)
        ),
    ]


def beyond(name: str, value: float | None) -> bool:
    """Return whether an error is beyond its limit; a value that was not computed is not."""
    return value is not None and name in LIMITS and not abs(value) <= LIMITS[name]


def _beyond_limits(content: Content) -> Iterator[str]:
    if content.held_out is None:
        yield "a single trial leaves nothing to hold out, so that no error can be judged; record at least five presses"
        return
    for name, limit in LIMITS.items():
        value = content.held_out[name].value
        if beyond(name, value):
            yield f"held-out {NAMES[name]} {value:{'.1%' if name == 'nrmse' else '+.1%'}}, limit {limit:.0%}"


def _implausible(content: Content) -> Iterator[str]:
    if content.plateaus:
        first, depth_mm = next(iter(content.plateaus.items()))
        yield (
            f"the force stays the same while the depth grows in {counted(len(content.plateaus), 'trial')} of "
            f"{content.trials} (first: {first}, from {depth_mm:.2g} mm on): a saturated load cell does that; use a "
            "larger range"
        )
    low, high = PUBLISHED
    if not low <= content.published_ratio <= high:
        yield (
            f"stiffness far from published tissue: {_of_published(content.published_ratio, content.region)}; is the "
            "force in newtons, and not in grams, volts or millinewtons?"
        )


def _of_published(ratio: float, region: str) -> str:
    name, times = region.replace("_", " "), f"{float(f'{ratio:.2g}'):g}"
    return f"the measured forces are {times} times those of a published {name} under the same presses"


def _inside(value: float, interval: tuple[float, float]) -> bool:
    low, high = interval
    slack = ROUNDING * max(abs(low), abs(high))
    return low - slack <= value <= high + slack

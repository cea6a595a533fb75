"""How long a policy takes for an answer, and what that means for a trial."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from carecontact.trials.finding import Finding


def latency_findings(took_s: Sequence[float], *, seconds: float, limit_s: float) -> Iterator[Finding]:
    """Yield findings about how long answers take.

    Args:
        took_s: wall time of every call [s].
        seconds: simulated time for which one answer lasts [s].
        limit_s: simulated time of a trial [s].
    """
    half, most = np.percentile(took_s, [50, 95])
    calls = int(np.ceil(limit_s / seconds))
    text = (
        f"p50 {1000 * half:.0f} ms, p95 {1000 * most:.0f} ms over {len(took_s)} calls; each gives {seconds:.2f} s of "
        f"motion, so a trial of {limit_s:g} s makes {calls} of them and waits {calls * half:.0f} s"
    )
    yield Finding(level="ok", topic="latency", text=text)
    if most > seconds >= half:
        yield Finding(
            level="hint",
            topic="latency",
            text="some calls take longer than their motion: a real robot would wait for them",
        )

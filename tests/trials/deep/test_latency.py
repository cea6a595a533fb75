"""What is said of the time that calls take."""

from __future__ import annotations

from carecontact.trials.deep.latency import latency_findings


def test_percentiles_and_what_a_trial_waits() -> None:
    (found,) = latency_findings([0.1] * 9 + [0.4], seconds=0.5, limit_s=30)
    assert found.text.startswith("p50 100 ms, p95 265 ms over 10 calls; each gives 0.50 s of motion")
    assert found.text.endswith("a trial of 30 s makes 60 of them and waits 6 s")


def test_some_slow_calls() -> None:
    assert [found.level for found in latency_findings([0.1] * 8 + [2, 2], seconds=0.5, limit_s=30)] == ["ok", "hint"]

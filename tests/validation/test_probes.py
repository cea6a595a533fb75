"""A probe passes with the right metric and fails with a wrong one."""

from __future__ import annotations

from dataclasses import replace

import pytest

from carecontact.recording.schema import Recording
from carecontact.scoring.contact import find_contact
from carecontact.scoring.metric import METRICS, Metric
from carecontact.validation.probes import PROBES, judge, sweep
from carecontact.validation.subject import Subject


def wrong(metric: Metric) -> dict[str, Metric]:
    """Metrics that a careless change could make of the right one."""
    return {
        "constant": replace(metric, compute=lambda contact: 1.0),
        "negated": replace(metric, compute=lambda contact: -(metric.compute(contact) or 0.0)),
        "never": replace(metric, compute=lambda contact: None),
        "not a number": replace(metric, compute=lambda contact: float("nan")),
    }


def check(probe_id: str, recordings: list[Recording]) -> None:
    probe, metric = PROBES[probe_id], METRICS[probe_id]
    assert len(probe.levels) >= 5
    assert judge(probe, recordings, metric).passed
    for name, other in wrong(metric).items():
        assert not judge(probe, recordings, other).passed, name


@pytest.fixture(scope="module")
def pushes(subject: Subject) -> list[Recording]:
    return sweep(subject, PROBES["C1@1"])


def test_deeper_pushes_raise_the_peak_force(pushes: list[Recording]) -> None:
    check("C1@1", pushes)


def test_the_sweeps_are_contacts_on_the_probed_region(pushes: list[Recording]) -> None:
    for recording in pushes:
        contact = find_contact(recording)
        assert contact.reported == contact.target


@pytest.mark.slow
@pytest.mark.parametrize("probe_id", sorted(set(PROBES) - {"C1@1"}))
def test_every_probe(probe_id: str, subject: Subject) -> None:
    check(probe_id, sweep(subject, PROBES[probe_id]))

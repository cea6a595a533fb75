"""A probe passes with the right metric and fails with a wrong one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import carecontact.scoring
from carecontact.lab.validation import probes
from carecontact.lab.validation.probes import PROBES, Trial, differentiated, judge, steps, sweep
from carecontact.lab.validation.subject import Subject
from carecontact.plotting import draw_figure
from carecontact.scoring.contact import Contact, find_contact
from carecontact.scoring.metrics.metric import METRICS, Metric
from tests.lab.validation.stored_sweeps import JOINT, RANGE, ROTATION, SETTLED, SPEED, read_sweep

assert carecontact.scoring, "registers C1 to C5"
Compute = Callable[[Contact], float | None]
Array = np.ndarray


def right(metric: str) -> Compute:
    return METRICS[metric].compute


def of_force(reduce: Callable[[Array], float]) -> Compute:
    """Of the force over the contact window; NA without contact."""
    return lambda contact: float(reduce(contact.force_in_window)) if contact.window.any() else None


def height(reduce: Callable[[Array], float]) -> Compute:
    return lambda contact: float(reduce(contact.recording["scorer/pose_tcp_in_world"][:, 2]))


def margins(contact: Contact) -> tuple[Array, Array]:
    """(T, J) to the lower and to the upper end."""
    (low, high), position = contact.recording[RANGE].T, contact.recording[JOINT]
    return position - low, high - position


def activity(speed_m_s: float = 0.005, rotation_rad_s: float = 0.05) -> Compute:
    def compute(contact: Contact) -> float:
        moves, turns = contact.recording[SPEED] > speed_m_s, contact.recording[ROTATION] > rotation_rad_s
        return float((moves | turns).mean())

    return compute


def duration(contact: Contact) -> float:
    return len(contact.time_s) * contact.dt_s


def scaled(metric: str, factor: float, offset: float = 0.0) -> Compute:
    return lambda contact: factor * (right(metric)(contact) or 0.0) + offset


GENERAL: dict[str, Compute] = {
    "constant": lambda contact: 1.0,
    "never": lambda contact: None,
    "not a number": lambda contact: float("nan"),
    "duration": duration,
    "contact time": lambda contact: float(contact.window.sum() * contact.dt_s),
    "contact share": lambda contact: float(contact.window.mean()),
    "contact-free share": lambda contact: 1 - float(contact.window.mean()),
    "impulse": lambda contact: float(contact.impulse_ns.sum()),
    "mean force": of_force(np.mean),
    "median force": of_force(np.median),
    "low force": of_force(lambda force: np.percentile(force, 10)),
    "high force": of_force(lambda force: np.percentile(force, 90)),
    "range of force": of_force(np.ptp),
    "variance of force": of_force(np.var),
    "mean change of force": of_force(lambda force: np.abs(np.diff(force)).mean()),
    "spread over the whole trial": lambda contact: float(contact.force_norm.max(axis=1).std()),
    "spread while off": lambda contact: float(contact.force_norm[~contact.window].std()),
    "lowest tool": height(lambda z: -z.min()),
    "spread of the tool's height": height(np.std),
    "mean speed": lambda contact: float(contact.recording[SPEED].mean()),
    "slowness": lambda contact: -float(contact.recording[SPEED].mean()),
}
"""Of any probe: none of these is C1, C2, C4 or C5."""

SPECIAL: dict[str, dict[str, Compute]] = {
    "C1@1": {"largest force but for 0.8 s": of_force(lambda force: np.sort(force)[-400])},
    "C2@1": {
        "upper end only": lambda contact: float(margins(contact)[1].min()),
        "lower end only": lambda contact: float(margins(contact)[0].min()),
        "farther end": lambda contact: float(np.maximum(*margins(contact)).min()),
        "mean over time": lambda contact: float(np.minimum(*margins(contact)).min(axis=1).mean()),
        "last sample": lambda contact: float(np.minimum(*margins(contact))[-1].min()),
        "mean over joints": lambda contact: float(np.minimum(*margins(contact)).mean(axis=1).min()),
        "degrees": scaled("C2@1", 180 / np.pi),
        "never below zero": lambda contact: max(0.0, right("C2@1")(contact) or 0.0),
        "change from settled": lambda contact: (
            -float(np.abs(contact.recording[JOINT] - contact.recording[SETTLED]).max())
        ),
    },
    "C4@1": {
        "rotation ignored": activity(rotation_rad_s=np.inf),
        "translation ignored": activity(speed_m_s=np.inf),
        "threshold of speed five times too high": activity(speed_m_s=0.025),
        "threshold of rotation five times too high": activity(rotation_rad_s=0.25),
        "threshold of speed in mm/s": activity(speed_m_s=5.0),
        "resting share": scaled("C4@1", -1.0, 1.0),
        "seconds": lambda contact: (right("C4@1")(contact) or 0.0) * duration(contact),
    },
    "C5@1": {"relative": of_force(lambda force: force.std() / force.mean())},
}


def wrong_metrics(metric: str) -> dict[str, Compute]:
    swapped = {f"{other} in its place": right(other) for other in PROBES if other != metric}
    general = {
        "negated": scaled(metric, -1.0), "a thousand times": scaled(metric, 1000.0),
        "a thousandth": scaled(metric, 1e-3), "five per cent too much": scaled(metric, 1.05),
    }  # fmt: skip
    return {**GENERAL, **general, **swapped, **SPECIAL[metric]}


CASES = [(metric, name) for metric in PROBES for name in wrong_metrics(metric)]


@pytest.fixture(scope="module")
def stored() -> dict[str, list[Trial]]:
    return {metric: read_sweep(metric) for metric in PROBES}


@pytest.fixture(scope="module")
def contacts(stored: dict[str, list[Trial]]) -> dict[str, list[Contact]]:
    return {metric: [find_contact(trial.recording) for trial in trials] for metric, trials in stored.items()}


@pytest.mark.parametrize("metric", PROBES)
def test_the_right_metric_passes(metric: str, stored: dict[str, list[Trial]]) -> None:
    assert len(PROBES[metric].levels) >= 5
    result = judge(PROBES[metric], stored[metric], METRICS[metric])
    assert result.passed, result.missed


@pytest.mark.parametrize(("metric", "name"), CASES)
def test_a_wrong_metric_fails(
    metric: str, name: str, stored: dict[str, list[Trial]], contacts: dict[str, list[Contact]],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    made = {id(t.recording): contact for t, contact in zip(stored[metric], contacts[metric], strict=True)}
    monkeypatch.setattr(probes, "find_contact", lambda recording: made[id(recording)])
    other = replace(METRICS[metric], measure=wrong_metrics(metric)[name])
    assert not judge(PROBES[metric], stored[metric], other).passed


@pytest.mark.parametrize("metric", PROBES)
def test_a_sweep_that_does_not_keep_the_rest_fails(metric: str, stored: dict[str, list[Trial]]) -> None:
    for name in stored[metric][0].held:
        first, *others = stored[metric]
        changed = replace(first, held={**first.held, name: 1.2 * first.held[name]})
        result = judge(PROBES[metric], [changed, *others], METRICS[metric])
        assert [measure.name for measure in result.missed] == [f"kept the same: {name}, range over mean"]


def test_the_least_step_decides() -> None:
    probe = replace(PROBES["C2@1"], levels=(-2.0, -1.0, 1.0, 3.0))
    np.testing.assert_allclose(steps(probe, np.array([0.1, 0.2, 0.4, 0.1])), [0.3, 0.1])
    assert steps(replace(PROBES["C1@1"], levels=(0.0, 1.0)), np.array([1.0, 0.9])).min() < 0


def test_speeds_by_differences() -> None:
    """A tool that goes 2 mm and turns by 0.01 rad in each step, once with the quaternion's sign flipped."""
    angle = 0.01 * np.arange(5)
    pose = np.stack(
        [0.002 * np.arange(5), *np.zeros((2, 5)), np.cos(angle / 2), np.sin(angle / 2), *np.zeros((2, 5))], 1
    )
    pose = np.asarray(pose, np.float64)
    pose[3, 3:] *= -1
    speed, rotation = differentiated(pose, 0.002)
    np.testing.assert_allclose(speed, 1.0)
    np.testing.assert_allclose(rotation, 5.0, rtol=1e-6)


def test_the_figure_is_drawn(stored: dict[str, list[Trial]], tmp_path: Path) -> None:
    results = [judge(PROBES[metric], stored[metric], METRICS[metric]) for metric in PROBES]
    draw_figure(lambda figure: probes.draw(results, figure), tmp_path / "probe.png")
    assert (tmp_path / "probe.png").stat().st_size > 10_000


@pytest.mark.slow
@pytest.mark.parametrize("metric", PROBES)
def test_in_simulation(metric: str, subject: Subject, stored: dict[str, list[Trial]]) -> None:
    """The right metric passes, and the stored sweep is what the simulator makes."""
    trials = sweep(subject, PROBES[metric])
    result = judge(PROBES[metric], trials, METRICS[metric])
    assert result.passed, result.missed
    np.testing.assert_allclose([t.known for t in trials], [t.known for t in stored[metric]], rtol=0.02, atol=1e-4)


@pytest.mark.slow
def test_the_sweeps_are_contacts_on_the_probed_region(subject: Subject) -> None:
    probe = PROBES["C1@1"]
    contact = find_contact(probe.script(subject.hovering(probe.region), probe.region, probe.levels[0]).recording)
    assert contact.valid
    assert contact.reported == contact.target


def test_metrics_are_registered() -> None:
    assert all(isinstance(METRICS[metric], Metric) for metric in PROBES)

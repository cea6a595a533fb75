"""Part (f) tests whether time, encoders, poses and pictures are what the recorded state gives, and nothing more."""

from __future__ import annotations

from pathlib import Path

from carecontact.audit.finding import Finding, Part
from carecontact.audit.fresh_process import said_by
from carecontact.audit.redraw import BOOTSTRAP
from carecontact.audit.watched import Watched
from carecontact.sim.opengl import choose_backend

NAME, TITLE = "readings", "time, encoders and images recomputed from the recorded state"


def audit_readings(logs: Path, trials: list[Watched]) -> Part:
    """Compare the readings of every observation with the recorded state.

    ``logs``: folder of raw logs. ``trials``: all trials that were run, also those whose observations are in no log.

    Raises CarecontactError if the process that draws again breaks.
    """
    backend = choose_backend()
    said = said_by(BOOTSTRAP, logs, environment={"MUJOCO_GL": backend, "PYOPENGL_PLATFORM": backend})
    findings = [
        Finding(policy=look["policy"], place=place, told=f"at {look['time_s']:.3f} s of {look['trial']}: {told}")
        for look in said["looks"]
        for place, told in look["differences"]
    ]
    for trial in trials:
        findings += _off_the_grid(trial)
    counts = {"looks": len(said["looks"]), "looks timed": sum(len(trial.look_steps) for trial in trials)}
    if said["images"]:
        counts["images drawn again"] = said["images"]
    return Part(name=NAME, title=TITLE, counts=counts, findings=tuple(findings))


def _off_the_grid(trial: Watched) -> list[Finding]:
    """Return the times, sent or recorded, that are not a whole number of physics steps to the last bit."""
    if trial.recording is None:
        return []
    dt_s = trial.recording.header.spec.protocol.physics.dt_s
    recorded = trial.recording["policy/observation_time_s"].tolist()
    found: list[Finding] = []
    for steps, sent_s in zip(trial.look_steps, trial.look_times_s, strict=True):
        if sent_s != steps * dt_s:
            told = f"{sent_s!r} s was sent after {steps} steps of {dt_s!r} s"
            found.append(Finding(policy=trial.policy, place="observation.sim_time_s", told=told))
    grid = [steps * dt_s for steps in trial.look_steps]
    if recorded[: len(grid)] != grid:
        told = f"is not the number of physics steps before each observation times {dt_s!r} s"
        found.append(Finding(policy=trial.policy, place="policy/observation_time_s", told=told))
    return found

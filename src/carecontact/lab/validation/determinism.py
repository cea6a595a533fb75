"""Check 6: the same trial in two fresh processes gives the same recording, bit for bit; so does a contact that goes on
from a restored state, and one beside another world."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict
from pathlib import Path

import mujoco
import numpy as np

from carecontact.errors import RecordingError
from carecontact.interface.regions import REGIONS
from carecontact.lab.validation.result import Array, CheckResult, Figure, Measure, measured
from carecontact.lab.validation.subject import Subject, axes, move_to, surface_point
from carecontact.protocol.protocol import TrialSpec
from carecontact.recording import canonical_hash, read_recording
from carecontact.recording.schema import Recording
from carecontact.scoring.contact import find_contact
from carecontact.serving.conversation import PolicySetup
from carecontact.sim.simulation import Simulation

TITLE = "Determinism"
TRIAL_S, QUICK_TRIAL_S = 20.0, 7.5
POLICY, TASK, SEED = "state-machine", "T1", 0
LONGEST_S = 600.0
PRESS_S, SLIDE_S, GO_ON_STEPS, DEEP_M, ASIDE_M = 0.6, 0.2, 200, 0.020, 0.02
"""Durations [s], steps and distances [m] of a press that slides aside and is interrupted on the way."""


def run(subject: Subject, *, quick: bool) -> CheckResult:
    """Run the check on trials of the package, which use the package's own scene and no other."""
    phases = subject.protocol.phases.model_copy(update={"time_limit_s": QUICK_TRIAL_S if quick else TRIAL_S})
    protocol = subject.protocol.model_copy(update={"phases": phases})
    recordings = first, second = two_recordings(TrialSpec(protocol=protocol, task_id=TASK, seed=SEED, policy=POLICY))
    kept = [path for path in first.arrays if not path.startswith("wall/")]
    different = sum(first.arrays[path].tobytes() != second.arrays[path].tobytes() for path in kept)
    hashes = {canonical_hash(recording) for recording in recordings}
    contacts = [find_contact(recording) for recording in recordings]
    time, force = contacts[0].time_s, contacts[0].force_norm
    segment = first.header.segments.index(REGIONS[protocol.task(TASK).region].segment)
    measures = (
        measured("canonical hashes that differ", len(hashes) - 1, at_most=0.0),
        measured("arrays that differ in any bit", different, at_most=0.0),
        *in_one_process(subject),
        measured("physics steps compared", len(time), at_least=1000.0),
        measured("largest force in them", force.max(), "N", at_least=0.5),
    )
    curves = {"time": time, "force": np.stack([contact.force_norm[:, segment] for contact in contacts])}
    return CheckResult(check="determinism", title=TITLE, measures=measures, curves=curves)


def in_one_process(subject: Subject) -> list[Measure]:
    """Measure what differs, for a press on each region that slides aside, if its state is restored in mid-contact, in
    the same world or in another one, and if another world of the same process runs in between."""
    restored, beside, force = 0, 0, np.inf
    for region in subject.regions():
        alone = _pressed(subject.hovering(region), region, ASIDE_M)
        state = alone.integration_state()
        force = min(force, float(np.linalg.norm(alone.tissue[region].last(alone.data, 1)[0]["force_n"])))
        wanted = _continued(alone)
        restored += not np.array_equal(_continued(alone, state), wanted)
        other, stranger = subject.hovering(region), _pressed(subject.hovering(region), region, -ASIDE_M)
        restored += not np.array_equal(_continued(other, state), wanted)
        beside += not np.array_equal(_continued(other, state, beside=stranger), wanted)
    return [
        measured("contacts that go on differently from a restored state", restored, at_most=0.0),
        measured("contacts that differ beside another world in the process", beside, at_most=0.0),
        measured("smallest force where they were interrupted", force, "N", at_least=0.5),
    ]


def _pressed(simulation: Simulation, region: str, aside_m: float) -> Simulation:
    """Press, and stop simulating while the tool slides aside."""
    top, (along, _) = surface_point(simulation, region), axes(simulation, region)
    below = top - [0.0, 0.0, DEEP_M]
    move_to(simulation, below, seconds=PRESS_S)
    move_to(simulation, below + aside_m * along, seconds=SLIDE_S)
    return simulation


def _continued(simulation: Simulation, state: Array | None = None, *, beside: Simulation | None = None) -> Array:
    """Return the state after GO_ON_STEPS more steps with the same commands, from the given state if there is one."""
    if state is not None:
        mujoco.mj_setState(simulation.model, simulation.data, state, int(mujoco.mjtState.mjSTATE_INTEGRATION))
    for _ in range(GO_ON_STEPS):
        mujoco.mj_step(simulation.model, simulation.data)
        if beside is not None:
            mujoco.mj_step(beside.model, beside.data)
    return simulation.integration_state()


def two_recordings(spec: TrialSpec) -> tuple[Recording, Recording]:
    """Run a trial twice in fresh processes at once. Raises RecordingError or OSError if one leaves nothing."""
    command, quiet = [sys.executable, "-m", "carecontact.running.worker"], subprocess.DEVNULL
    request = {"spec": spec.model_dump(mode="json"), "policy": asdict(PolicySetup.of(spec.policy))}

    def record(path: Path) -> None:
        given = json.dumps({**request, "out": str(path)}).encode()
        subprocess.run(command, input=given, stdout=quiet, stderr=quiet, timeout=LONGEST_S)

    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor() as pool:
        paths = [Path(folder) / f"{n}.h5" for n in (1, 2)]
        try:
            list(pool.map(record, paths))
        except subprocess.TimeoutExpired:
            limit = spec.protocol.phases.time_limit_s
            raise RecordingError(f"a trial of {limit:g} s was not over after {LONGEST_S:g} s") from None
        first, second = (read_recording(path) for path in paths)
        return first, second


def draw(result: CheckResult, figure: Figure) -> None:
    figure.set_size_inches(3.6, 2.4)
    axes = figure.subplots()
    time, (first, second) = result.curves["time"], result.curves["force"]
    axes.plot(time, first, label="first process")
    axes.plot(time, second, ":", label="second process")
    axes.set(xlabel="time [s]", ylabel="force [N]", title="one trial, run twice")
    axes.legend()

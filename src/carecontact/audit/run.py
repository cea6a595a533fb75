"""The whole audit: its parts on every region of the person, and the file that it leaves."""

from __future__ import annotations

import json
import shutil
import tempfile
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product
from pathlib import Path
from textwrap import shorten
from typing import Any

from carecontact.audit import hidden_values, schema
from carecontact.audit.finding import TIME, TITLES, Finding, Part, findings, output_of
from carecontact.audit.rederive import REDERIVE_BOOTSTRAP
from carecontact.audit.redraw import REDRAW_BOOTSTRAP
from carecontact.audit.watched import CONTROL_HZ, Keyframe, Watched, press, watch
from carecontact.episode.randomization import World, settled_world, without_draws
from carecontact.interface.observation import MODALITIES
from carecontact.interface.policy import CAMERAS, MAX_NAME, PolicyCard
from carecontact.protocol.protocol import Protocol, TrialSpec
from carecontact.recording.provenance import package_versions
from carecontact.serving.conversation import PolicySetup
from carecontact.sim.opengl import choose_backend
from carecontact.sim.simulation import Simulation


def audit_derivation(logs: Path, pressed: list[Watched]) -> Part:
    """Part (a) tests whether every byte sent to a policy is a function of images, calibration and encoders: it derives
    every logged message again and compares it with the one that was sent."""
    again = output_of(REDERIVE_BOOTSTRAP, logs)
    found = _of_looks(again["looks"])
    if again["simulators"]:
        imports = f"the process that recomputes observations could import a simulator: {', '.join(again['simulators'])}"
        found.append(Finding("", "re-derivation", imports))
    counts = {
        "observations": len(again["looks"]),
        "observations in contact": sum(trial.looks_in_contact for trial in pressed),
        "bytes": sum(look["bytes"] for look in again["looks"]),
    }
    return Part(name="re-derivation", counts=counts, findings=tuple(found))


def audit_readings(logs: Path, trials: list[Watched]) -> Part:
    """Part (f) tests whether time, encoders, poses and pictures are what the recorded state gives, and nothing more."""
    backend = choose_backend()
    again = output_of(REDRAW_BOOTSTRAP, logs, environment={"MUJOCO_GL": backend, "PYOPENGL_PLATFORM": backend})
    found = _of_looks(again["looks"])
    for trial in trials:
        found += _off_the_grid(trial)
    counts = {"looks": len(again["looks"]), "looks timed": sum(len(trial.look_steps) for trial in trials)}
    if again["images"]:
        counts["images drawn again"] = again["images"]
    return Part(name="readings", counts=counts, findings=tuple(found))


def _of_looks(looks: list[dict[str, Any]]) -> list[Finding]:
    found: list[Finding] = []
    for look in looks:
        when = f"at {look['time_s']:.3f} s of {look['trial']}: "
        found += findings(look["policy"], look["differences"], before=when)
    return found


def _off_the_grid(trial: Watched) -> list[Finding]:
    """Return the times, sent or recorded, that are not a whole number of physics steps to the last bit."""
    if trial.recording is None:
        return []
    dt_s = trial.recording.header.spec.protocol.physics.dt_s
    recorded = trial.recording["policy/observation_time_s"].tolist()
    found = [
        ("observation.sim_time_s", f"{sent_s!r} s was sent after {steps} steps of {dt_s!r} s")
        for steps, sent_s in zip(trial.look_steps, trial.look_times_s, strict=True)
        if sent_s != steps * dt_s
    ]
    grid = [steps * dt_s for steps in trial.look_steps]
    if recorded[: len(grid)] != grid:
        off = f"is not the number of physics steps before each observation times {dt_s!r} s"
        found.append(("policy/observation_time_s", off))
    return findings(trial.policy, found)


QUICK_TRIAL_S = 0.1
"""Length [s] of the policies' trials in the quick form: one observation, with the robot parked."""
QUICK_ACTIONS_PER_LOOK = 3
"""Actions for each look in the quick form, where presses with images observe every 0.15 s. All other presses observe at
every action."""
BLIND = PolicyCard(name="every policy", control_hz=CONTROL_HZ)


def _parts_of_region(
    spec: TrialSpec,
    task_ids: Sequence[str],
    policies: Sequence[PolicySetup],
    trials: list[Watched],
    *,
    folder: Path,
    quick: bool,
    on_event: Callable[[str], None],
) -> Iterator[Part]:
    """Run the trials of one region, and yield what each part finds.

    ``spec``: of a task of the region, without a policy. ``trials``: grows by the policies' own trials.
    """
    logs, witness, task = folder / "logs", folder / "witness", spec.protocol.task(spec.task_id)
    keyframe = Keyframe(spec.protocol, task_id=task.id, seed=spec.seed, salt=spec.salt)
    region = task.region.replace("_", " ")
    real, pressed = list[Watched](), list[Watched]()
    logs.mkdir()
    for task_id, (index, policy) in product(task_ids, enumerate(policies)):
        on_event(f"running a trial of {policy.ref}, {task_id}")
        own, log = _of_policy(spec, policy, task_id, quick=quick), logs / f"real-{task_id}-{index:02d}"
        trial = watch(own, policy=policy.ref.text, prepare=keyframe.parked, log=log, setup=policy)
        yield schema.audit_schema([trial])
        trial.forget()
        real.append(trial)
    trials += real
    cards = cards_of(trials, together=quick)
    quiet = spec.model_copy(update={"protocol": hidden_values.without_noise(spec.protocol)})
    other = hidden_values.other_hidden_values(quiet)
    pressing = partial(press, poses=keyframe.poses, folder=witness)
    for index, card in enumerate(cards):
        on_event(f"running two presses on the {region} with the card of {card.name}")
        seldom, log = quick and bool(card.modalities), logs / f"press-{task.region}-{index:02d}"
        actions = QUICK_ACTIONS_PER_LOOK if seldom else 1
        one = pressing(quiet, card=card, prepare=keyframe.near, actions_per_look=actions, log=log)
        twin = pressing(other, card=card, prepare=keyframe.twin, actions_per_look=actions)
        yield hidden_values.audit_canary(one, twin)
        yield hidden_values.audit_handshake(one, twin)
        pressed.append(one)
        if seldom:
            # Only images cost time, so that presses without images observe as often as in the full form.
            log = logs / f"blind-{log.name}"
            pressed.append(pressing(quiet, card=BLIND, prepare=keyframe.near, actions_per_look=1, log=log))
        one.forget()
    on_event("starting two trials with the arm at different angles")
    yield hidden_values.audit_start(*two_starts(quiet, keyframe, folder=witness))
    on_event(f"scrambling the hidden state in contact with the {region}")
    yield hidden_values.audit_frozen(_at_contact(keyframe, spec), cards, instruction=task.prompt)
    on_event("recomputing all observations without a simulator")
    yield audit_derivation(logs, pressed)
    on_event("recomputing time, encoders and images from the recorded state")
    yield audit_readings(logs, [*real, *pressed])
    # They take hundreds of megabytes for each region.
    shutil.rmtree(logs)


def _of_policy(spec: TrialSpec, policy: PolicySetup, task_id: str, *, quick: bool) -> TrialSpec:
    protocol = spec.protocol
    if quick:
        phases = protocol.phases.model_copy(update={"time_limit_s": QUICK_TRIAL_S})
        protocol = protocol.model_copy(update={"phases": phases})
    given = {"policy_arguments": dict(policy.arguments), "policy_environment": tuple(policy.environment)}
    return spec.model_copy(
        update={"policy": policy.ref.text, **given, "protocol": protocol, "task_id": task_id},
    )


def cards_of(trials: Sequence[Watched], *, together: bool) -> list[PolicyCard]:
    """Return one card for each different request, named after its policies, or one for all ``together``."""
    asked: dict[tuple[tuple[str, ...], tuple[str, ...]], list[str]] = {}
    for trial in trials:
        if card := trial.card:
            asked.setdefault((card.modalities, card.cameras), []).append(trial.policy)
    if together and asked:
        modalities, cameras = ({one for wanted in asked for one in wanted[part]} for part in (0, 1))
        all_modalities = tuple(name for name in MODALITIES if name in modalities)
        all_cameras = tuple(name for name in CAMERAS if name in cameras)
        asked = {(all_modalities, all_cameras): [name for group in asked.values() for name in group]}
    cards: list[PolicyCard] = []
    for (modalities, cameras), names in asked.items():
        name = shorten(", ".join(dict.fromkeys(names)), MAX_NAME, placeholder=" and others")
        cards.append(PolicyCard(name=name, modalities=modalities, cameras=cameras, control_hz=CONTROL_HZ))
    return cards


def two_starts(spec: TrialSpec, keyframe: Keyframe, *, folder: Path) -> tuple[Watched, Watched]:
    """Run one step of two trials whose seeds differ in the arm's angle, and in nothing that a policy may know."""

    def settled(spec: TrialSpec) -> World:
        return settled_world(spec.protocol, task_id=spec.task_id, seed=spec.seed, salt=spec.salt)

    poses = keyframe.parked_pose[None]
    one = press(spec, card=BLIND, poses=poses, prepare=keyframe.parked, actions_per_look=1, folder=folder)
    same = hidden_values.without_noise(without_draws(keyframe.scene.protocol))
    other = hidden_values.other_arm_angle(spec.model_copy(update={"protocol": same}), own_deg=keyframe.laid_at_deg)
    return one, press(other, card=BLIND, poses=poses, prepare=settled, actions_per_look=1, folder=folder)


def _at_contact(keyframe: Keyframe, spec: TrialSpec) -> Simulation:
    simulation, _, _ = keyframe.near(spec)
    steps = round(1 / CONTROL_HZ / simulation.model.opt.timestep)
    for pose in keyframe.poses:
        simulation.set_goal(pose, 1 / CONTROL_HZ)
        simulation.advance(steps)
    simulation.refresh()
    return simulation


SCHEMA = "carecontact-audit-1"


@dataclass(frozen=True, kw_only=True)
class Audit:
    protocol: Protocol
    policies: tuple[str, ...]
    quick: bool
    seed: int
    trials: tuple[Watched, ...]
    """The policies' own trials, without those of the witness."""
    parts: tuple[Part, ...]
    privileged: tuple[str, ...] = ()

    @property
    def passed(self) -> bool:
        return all(part.passed for part in self.parts)

    def as_json(self) -> dict[str, Any]:
        """Return the content of ``audit.json``; if all passed, nothing in it depends on place, time or machine."""
        rules = self.protocol
        person = {"body": rules.person.body, "seed": self.seed}
        return {
            "schema": SCHEMA,
            "passed": self.passed,
            "quick": self.quick,
            "policies": list(self.policies),
            "privileged": list(self.privileged),
            "trials": [trial.as_json() for trial in self.trials],
            "protocol": {"id": rules.name, "level": rules.level, "sha256": rules.sha256, **person},
            "versions": package_versions(),
            "parts": [part.as_json() for part in self.parts],
        }


def audit(
    protocol: Protocol,
    policies: Sequence[PolicySetup],
    *,
    quick: bool,
    tasks: Sequence[str] = (),
    seed: int | None = None,
    salt: str = "",
    privileged: Sequence[str] = (),
    on_event: Callable[[str], None] = lambda event: None,
) -> Audit:
    """Run every part on every policy. The quick form presses with one card that requests all that the policies request.
    The full form presses with each card, and lets the policies' own trials run to their end."""
    if seed is None:
        seed = protocol.randomization.seeds[0] if protocol.randomization.seeds else 0
    found: dict[str, list[Part]] = defaultdict(list)
    trials: list[Watched] = []
    with tempfile.TemporaryDirectory(prefix="carecontact-audit-") as folder:
        for task_ids in _by_region(protocol, tasks, quick=quick):
            spec = TrialSpec(protocol=protocol, task_id=task_ids[0], seed=seed, policy="", salt=salt)
            options = {"folder": Path(folder), "quick": quick, "on_event": on_event}
            for part in _parts_of_region(spec, task_ids, policies, trials, **options):
                found[part.name].append(part)
    return Audit(
        protocol=protocol,
        policies=tuple(policy.ref.text for policy in policies),
        quick=quick,
        seed=seed,
        trials=tuple(trials),
        parts=tuple(_merged(name, found[name]) for name in TITLES if name != TIME),
        privileged=tuple(privileged),
    )


def write(result: Audit, folder: Path) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "audit.json"
    path.write_text(json.dumps(result.as_json(), indent=2) + "\n")
    return path


def _by_region(protocol: Protocol, tasks: Sequence[str], *, quick: bool) -> list[list[str]]:
    """Return the ids of the tasks to audit, those of one region together."""
    regions: dict[str, list[str]] = defaultdict(list)
    for task in protocol.tasks:
        if task.id in tasks or not (tasks or regions[task.region]):
            regions[task.region].append(task.id)
    named = [task_ids for task_ids in regions.values() if task_ids]
    return named[:1] if quick and not tasks else named


def _merged(name: str, parts: Sequence[Part]) -> Part:
    """Merge the results of one part over the regions; without any result the part has not passed."""
    counts: Counter[str] = Counter()
    for part in parts:
        counts.update(part.counts)
    found = tuple(finding for part in parts for finding in part.findings)
    return Part(name=name, counts=dict(counts) or {"policies that showed a card": 0}, findings=found)

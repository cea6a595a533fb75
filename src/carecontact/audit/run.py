"""The whole audit: its parts on every region of the person, and the file that it leaves."""

from __future__ import annotations

import json
import shutil
import tempfile
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from typing import Any

from carecontact.audit import hidden_values, schema
from carecontact.audit.finding import Finding, Part, findings, output_of
from carecontact.audit.rederive import REDERIVE_BOOTSTRAP
from carecontact.audit.redraw import REDRAW_BOOTSTRAP
from carecontact.audit.watched import CONTROL_HZ, Keyframe, Prepare, Watched, press, watch
from carecontact.episode.randomization import settled_world, without_draws
from carecontact.interface.observation import MODALITIES
from carecontact.interface.policy import CAMERAS, PolicyCard
from carecontact.protocol.protocol import Protocol, TrialSpec
from carecontact.recording.provenance import package_versions
from carecontact.serving.conversation import PolicySetup
from carecontact.sim.opengl import choose_backend
from carecontact.sim.simulation import Settled, Simulation

DERIVATION_NAME, DERIVATION_TITLE = "re-derivation", "observations recomputed without a simulator"
READINGS_NAME, READINGS_TITLE = "readings", "time, encoders and images recomputed from the recorded state"


def audit_derivation(logs: Path, pressed: list[Watched]) -> Part:
    """Part (a) tests whether every byte sent to a policy is a function of images, calibration and encoders: it derives
    every logged message again and compares it with the one that was sent.

    ``logs``: folder of raw logs of trials. ``pressed``: the trials among them in which contact must occur.

    Raises CarecontactError if the process that derives the messages breaks.
    """
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
    return Part(name=DERIVATION_NAME, title=DERIVATION_TITLE, counts=counts, findings=tuple(found))


def audit_readings(logs: Path, trials: list[Watched]) -> Part:
    """Part (f) tests whether time, encoders, poses and pictures are what the recorded state gives, and nothing more.

    ``logs``: folder of raw logs. ``trials``: all trials that were run, also those whose observations are in no log.

    Raises CarecontactError if the process that draws again breaks.
    """
    backend = choose_backend()
    again = output_of(REDRAW_BOOTSTRAP, logs, environment={"MUJOCO_GL": backend, "PYOPENGL_PLATFORM": backend})
    found = _of_looks(again["looks"])
    for trial in trials:
        found += _off_the_grid(trial)
    counts = {"looks": len(again["looks"]), "looks timed": sum(len(trial.look_steps) for trial in trials)}
    if again["images"]:
        counts["images drawn again"] = again["images"]
    return Part(name=READINGS_NAME, title=READINGS_TITLE, counts=counts, findings=tuple(found))


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


@dataclass(kw_only=True)
class RegionAudit:
    """Runs the trials of one region. Call the methods in their order; each passes its findings to ``add``."""

    spec: TrialSpec
    """Trial spec of a task of the region; each trial fills in its policy, and a policy's own trial its task."""
    number: int
    """Number of the region, from 0."""
    keyframe: Keyframe
    folder: Path
    quick: bool
    on_event: Callable[[str], None]
    add: Callable[[Part], None]
    _real: list[Watched] = field(default_factory=list[Watched], init=False)
    _pressed: list[Watched] = field(default_factory=list[Watched], init=False)

    def __post_init__(self) -> None:
        self._log, self._witness = self.folder / "logs", self.folder / "witness"
        self._task = self.spec.protocol.task(self.spec.task_id)
        self._name = self._task.region.replace("_", " ")
        quiet = hidden_values.without_noise(self.spec.protocol)
        self._quiet = self.spec.model_copy(update={"protocol": quiet})

    @contextmanager
    def logs(self) -> Iterator[None]:
        """Keep the folder of raw logs until the block ends, because they take hundreds of megabytes for each region."""
        self._log.mkdir()
        yield
        shutil.rmtree(self._log)

    def try_policies(self, policies: Sequence[PolicySetup], task_ids: Sequence[str]) -> list[Watched]:
        """Run one trial of every policy for each of these tasks of the region, and check its messages against its
        card."""
        for task_id, (index, policy) in product(task_ids, enumerate(policies)):
            self.on_event(f"running a trial of {policy.ref}, {task_id}")
            spec = _shortened(self.spec, policy, quick=self.quick).model_copy(update={"task_id": task_id})
            log, name = self._log / f"real-{task_id}-{index:02d}", policy.ref.text
            trial = watch(spec, policy=name, prepare=self.keyframe.parked, log=log, setup=policy)
            self.add(schema.audit_schema([trial]))
            trial.forget()
            self._real.append(trial)
        return self._real

    def press_with(self, cards: Sequence[PolicyCard]) -> None:
        """With each card, run two presses in worlds that differ in hidden values; also run two starts."""
        other = hidden_values.other_hidden_values(self._quiet)
        for index, card in enumerate(cards):
            self.on_event(f"running two presses on the {self._name} with the card of {card.name}")
            seldom, log = self.quick and bool(card.modalities), self._log / f"press-{self.number}-{index:02d}"
            actions = QUICK_ACTIONS_PER_LOOK if seldom else 1
            one = self._press(self._quiet, card, self.keyframe.near, actions, log)
            twin = self._press(other, card, self.keyframe.twin, actions)
            self.add(hidden_values.audit_canary(one, twin))
            self.add(hidden_values.audit_handshake(one, twin))
            self._pressed.append(one)
            if seldom:
                # Only images cost time, so that presses without images observe as often as in the full form.
                blind = log.with_name(f"blind-{log.name}")
                self._pressed.append(self._press(self._quiet, BLIND, self.keyframe.near, 1, blind))
            one.forget()
        self.on_event("starting two trials with the arm at different angles")
        self.add(hidden_values.audit_start(*two_starts(self._quiet, self.keyframe, folder=self._witness)))

    def _press(
        self, spec: TrialSpec, card: PolicyCard, prepare: Prepare, actions_per_look: int, log: Path | None = None
    ) -> Watched:
        poses, folder = self.keyframe.poses, self._witness
        return press(
            spec, card=card, poses=poses, prepare=prepare, actions_per_look=actions_per_look, folder=folder, log=log
        )

    def scramble(self, cards: Sequence[PolicyCard]) -> None:
        self.on_event(f"scrambling the hidden state in contact with the {self._name}")
        world = _at_contact(self.keyframe, self.spec)
        self.add(hidden_values.audit_frozen(world, cards, instruction=self._task.prompt))

    def make_again(self) -> None:
        """Make every logged observation again, from readings and pictures that are read and drawn again."""
        self.on_event("recomputing all observations without a simulator")
        self.add(audit_derivation(self._log, self._pressed))
        self.on_event("recomputing time, encoders and images from the recorded state")
        self.add(audit_readings(self._log, [*self._real, *self._pressed]))


def _shortened(spec: TrialSpec, policy: PolicySetup, *, quick: bool) -> TrialSpec:
    protocol = spec.protocol
    if quick:
        phases = protocol.phases.model_copy(update={"time_limit_s": QUICK_TRIAL_S})
        protocol = protocol.model_copy(update={"phases": phases})
    return spec.model_copy(
        update={
            "policy": policy.ref.text,
            "policy_arguments": dict(policy.arguments),
            "policy_environment": tuple(policy.environment),
            "protocol": protocol,
        }
    )


def cards_of(trials: Sequence[Watched], *, together: bool) -> list[PolicyCard]:
    """Return one card for each different request, named after the policies that make it, or one card for all
    together."""
    asked: dict[tuple[tuple[str, ...], tuple[str, ...]], list[str]] = {}
    for trial in trials:
        if card := trial.card:
            asked.setdefault((card.modalities, card.cameras), []).append(trial.policy)
    if together and asked:
        modalities, cameras = ({one for wanted in asked for one in wanted[part]} for part in (0, 1))
        all_modalities = tuple(name for name in MODALITIES if name in modalities)
        all_cameras = tuple(name for name in CAMERAS if name in cameras)
        asked = {(all_modalities, all_cameras): [name for group in asked.values() for name in group]}
    return [
        PolicyCard(name=", ".join(dict.fromkeys(names)), modalities=modalities, cameras=cameras, control_hz=CONTROL_HZ)
        for (modalities, cameras), names in asked.items()
    ]


def two_starts(spec: TrialSpec, keyframe: Keyframe, *, folder: Path) -> tuple[Watched, Watched]:
    """Run one step of two trials whose seeds lay the person's arm at different angles.

    What a policy may know of the draws, where robot and overhead camera stand, is the same in both.
    """
    poses = keyframe.parked_pose[None]
    one = press(spec, card=BLIND, poses=poses, prepare=keyframe.parked, actions_per_look=1, folder=folder)
    same = hidden_values.without_noise(without_draws(keyframe.scene.protocol))
    other = hidden_values.other_arm_angle(spec.model_copy(update={"protocol": same}), own_deg=keyframe.laid_at_deg)
    return one, press(other, card=BLIND, poses=poses, prepare=_settled, actions_per_look=1, folder=folder)


def _settled(spec: TrialSpec) -> tuple[Simulation, Settled, str]:
    return settled_world(spec.protocol, task_id=spec.task_id, seed=spec.seed, salt=spec.salt)


def _at_contact(keyframe: Keyframe, spec: TrialSpec) -> Simulation:
    """Return a world at the end of the press."""
    simulation, _, _ = keyframe.near(spec)
    steps = round(1 / CONTROL_HZ / simulation.model.opt.timestep)
    for pose in keyframe.poses:
        simulation.set_goal(pose, 1 / CONTROL_HZ)
        simulation.advance(steps)
    simulation.refresh()
    return simulation


SCHEMA = "carecontact-audit-1"
PARTS = (
    (DERIVATION_NAME, DERIVATION_TITLE),
    (READINGS_NAME, READINGS_TITLE),
    (hidden_values.FROZEN_NAME, hidden_values.FROZEN_TITLE),
    (hidden_values.CANARY_NAME, hidden_values.CANARY_TITLE),
    (hidden_values.HANDSHAKE_NAME, hidden_values.HANDSHAKE_TITLE),
    (schema.SCHEMA_NAME, schema.SCHEMA_TITLE),
)
"""Names and titles of the parts, in the order of the table."""


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
    """Policies that were left out because they are given the whole simulation."""

    @property
    def passed(self) -> bool:
        return all(part.passed for part in self.parts)

    def as_json(self) -> dict[str, Any]:
        """Return the content of ``audit.json``. If everything passed, nothing in it depends on place, time or
        machine."""
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
    """Run every part on every policy.

    The quick form presses with one card that requests all that the policies request. The full form presses with each
    card, and lets the policies' own trials run to their end.

    Args:
        tasks: each policy runs a trial of each of these tasks, and the audit presses on their regions. By default the
            first task of every region of the protocol, in the quick form only the first of all.
        seed: of the person; by default the protocol's first seed.
        salt: the secret of a salted run, on whose person the audit then runs.
        privileged: names of policies that are left out; the result names them.

    Raises SceneError or SettleError where no world can be made, CarecontactError if the audit itself breaks.
    """
    if seed is None:
        seed = protocol.randomization.seeds[0] if protocol.randomization.seeds else 0
    found: dict[str, list[Part]] = defaultdict(list)
    trials: list[Watched] = []
    with tempfile.TemporaryDirectory(prefix="carecontact-audit-") as folder:
        for number, task_ids in enumerate(_by_region(protocol, tasks, quick=quick)):
            spec = TrialSpec(protocol=protocol, task_id=task_ids[0], seed=seed, policy="", salt=salt)
            region = RegionAudit(
                spec=spec,
                number=number,
                keyframe=Keyframe(protocol, task_id=task_ids[0], seed=seed, salt=salt),
                folder=Path(folder),
                quick=quick,
                on_event=on_event,
                add=lambda part: found[part.name].append(part),
            )
            with region.logs():
                trials += region.try_policies(policies, task_ids)
                cards = cards_of(trials, together=quick)
                region.press_with(cards)
                region.scramble(cards)
                region.make_again()
    return Audit(
        protocol=protocol,
        policies=tuple(policy.ref.text for policy in policies),
        quick=quick,
        seed=seed,
        trials=tuple(trials),
        parts=tuple(_merged(name, title, found[name]) for name, title in PARTS),
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


def _merged(name: str, title: str, parts: Sequence[Part]) -> Part:
    """Merge the results of one part over the regions; without any result the part has not passed."""
    counts: Counter[str] = Counter()
    for part in parts:
        counts.update(part.counts)
    found = tuple(finding for part in parts for finding in part.findings)
    return Part(name=name, title=title, counts=dict(counts) or {"policies that showed a card": 0}, findings=found)

"""Everything that the audit runs on one region of the person: trials of the policies, presses, and checks of both."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from carecontact.audit import canary, derivation, frozen, handshake, readings, schema
from carecontact.audit.finding import Part
from carecontact.audit.keyframe import CONTROL_HZ, Keyframe
from carecontact.audit.watched import Watched, press, watch
from carecontact.contract.observation import MODALITIES
from carecontact.contract.policy import CAMERAS, PolicyCard
from carecontact.contract.trial import TrialSpec
from carecontact.episode.drawn import settled_draws
from carecontact.episode.prepare import settled_world
from carecontact.hosting.setup import PolicySetup
from carecontact.sim.simulation import Settled, Simulation

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

    @property
    def _log(self) -> Path:
        return self.folder / "logs"

    @property
    def _witness(self) -> Path:
        return self.folder / "witness"

    @property
    def _quiet(self) -> TrialSpec:
        return self.spec.model_copy(update={"protocol": canary.without_noise(self.spec.protocol)})

    @property
    def _name(self) -> str:
        return self.spec.protocol.task(self.spec.task_id).region.replace("_", " ")

    @contextmanager
    def logs(self) -> Iterator[None]:
        """Keep the folder of raw logs until the block ends, because they take hundreds of megabytes for each region."""
        self._log.mkdir()
        yield
        shutil.rmtree(self._log)

    def try_policies(self, policies: Sequence[PolicySetup], task_ids: Sequence[str]) -> list[Watched]:
        """Run one trial of every policy for each of these tasks of the region, and check its messages against its
        card.
        """
        for task_id in task_ids:
            for index, policy in enumerate(policies):
                self.on_event(f"running a trial of {policy.ref}, {task_id}")
                spec = _shortened(self.spec, policy, quick=self.quick).model_copy(update={"task_id": task_id})
                trial = watch(
                    spec, policy=policy.ref.text, prepare=self.keyframe.parked,
                    log=self._log / f"real-{task_id}-{index:02d}", setup=policy,
                )  # fmt: skip
                self.add(schema.audit_schema([trial]))
                trial.forget()
                self._real.append(trial)
        return self._real

    def press_with(self, cards: Sequence[PolicyCard]) -> None:
        """With each card, run two presses in worlds that differ in hidden values; also run two starts."""
        for index, card in enumerate(cards):
            self.on_event(f"running two presses on the {self._name} with the card of {card.name}")
            seldom, log = self.quick and bool(card.modalities), self._log / f"press-{self.number}-{index:02d}"
            one, twin = _pair(
                self._quiet, card, self.keyframe, actions_per_look=QUICK_ACTIONS_PER_LOOK if seldom else 1,
                folder=self._witness, log=log,
            )  # fmt: skip
            self.add(canary.audit_canary(one, twin))
            self.add(handshake.audit_handshake(one, twin))
            self._pressed.append(one)
            if seldom:
                # Only images cost time, so that presses without images observe as often as in the full form.
                blind = log.with_name(f"blind-{log.name}")
                self._pressed.append(_blind_press(self._quiet, self.keyframe, folder=self._witness, log=blind))
            one.forget()
        self.on_event("starting two trials with the arm at different angles")
        self.add(handshake.audit_start(*two_starts(self._quiet, self.keyframe, folder=self._witness)))

    def scramble(self, cards: Sequence[PolicyCard]) -> None:
        """Scramble everything hidden in a world in contact, and compare the observations."""
        self.on_event(f"scrambling the hidden state in contact with the {self._name}")
        prompt = self.spec.protocol.task(self.spec.task_id).prompt
        self.add(frozen.audit_frozen(_at_contact(self.keyframe, self.spec), cards, instruction=prompt))

    def make_again(self) -> None:
        """Make every logged observation again, from readings and pictures that are read and drawn again."""
        self.on_event("recomputing all observations without a simulator")
        self.add(derivation.audit_derivation(self._log, self._pressed))
        self.on_event("recomputing time, encoders and images from the recorded state")
        self.add(readings.audit_readings(self._log, [*self._real, *self._pressed]))


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
    together.
    """
    asked: dict[tuple[tuple[str, ...], tuple[str, ...]], list[str]] = {}
    for trial in trials:
        card = trial.card
        if card is not None:
            wanted = (card.modalities, card.cameras)
            asked.setdefault(wanted, []).append(trial.policy)
    if together and asked:
        modalities = {m for wanted, _ in asked for m in wanted}
        cameras = {c for _, wanted in asked for c in wanted}
        names = [name for group in asked.values() for name in group]
        asked = {(_in_order(modalities, MODALITIES), _in_order(cameras, CAMERAS)): names}
    return [
        PolicyCard(name=", ".join(dict.fromkeys(names)), modalities=modalities, cameras=cameras, control_hz=CONTROL_HZ)
        for (modalities, cameras), names in asked.items()
    ]


def _in_order(wanted: set[str], order: Sequence[str]) -> tuple[str, ...]:
    return tuple(name for name in order if name in wanted)


def _pair(
    spec: TrialSpec, card: PolicyCard, keyframe: Keyframe, *, actions_per_look: int, folder: Path, log: Path
) -> tuple[Watched, Watched]:
    """Run the same press in two worlds that differ in hidden values, and log the first one."""
    poses = keyframe.poses
    one = press(
        spec, card=card, poses=poses, prepare=keyframe.near, actions_per_look=actions_per_look, folder=folder, log=log
    )
    other = canary.other_hidden_values(spec)
    return one, press(
        other, card=card, poses=poses, prepare=keyframe.twin, actions_per_look=actions_per_look, folder=folder
    )


def _blind_press(spec: TrialSpec, keyframe: Keyframe, *, folder: Path, log: Path) -> Watched:
    return press(
        spec, card=BLIND, poses=keyframe.poses, prepare=keyframe.near, actions_per_look=1, folder=folder, log=log
    )


def two_starts(spec: TrialSpec, keyframe: Keyframe, *, folder: Path) -> tuple[Watched, Watched]:
    """Run one step of two trials whose seeds lay the person's arm at different angles.

    What a policy may know of the draws, where robot and overhead camera stand, is the same in both.
    """
    poses = keyframe.parked_pose[None]
    one = press(spec, card=BLIND, poses=poses, prepare=keyframe.parked, actions_per_look=1, folder=folder)
    same = canary.without_noise(settled_draws(keyframe.scene.protocol))
    other = canary.other_arm_angle(spec.model_copy(update={"protocol": same}), own_deg=keyframe.laid_at_deg)
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

"""The whole audit: its trials, its six parts, and the file that it leaves."""

from __future__ import annotations

import json
import shutil
import tempfile
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from carecontact.audit import canary, derivation, frozen, handshake, readings, schema
from carecontact.audit.finding import Part
from carecontact.audit.keyframe import CONTROL_HZ, Keyframe
from carecontact.audit.watched import Watched, press, watch
from carecontact.contract.observation import MODALITIES
from carecontact.contract.policy import CAMERAS, PolicyCard
from carecontact.contract.protocol import Protocol
from carecontact.contract.trial import TrialSpec
from carecontact.episode.prepare import settled_world
from carecontact.hosting.setup import PolicySetup
from carecontact.recording.versions import package_versions
from carecontact.sim.simulation import Settled, Simulation

SCHEMA = "carecontact-audit-1"
PARTS = (derivation, readings, frozen, canary, handshake, schema)
"""Modules with a NAME and a TITLE, in the order of the table."""
QUICK_TRIAL_S = 0.1
"""Of the real policies' trials in the quick form: one look, with the robot parked."""
QUICK_ACTIONS_PER_LOOK = 3
"""Of presses that are seen, in the quick form: a look every 0.15 s. All others look at every action."""
BLIND = PolicyCard(name="every policy", control_hz=CONTROL_HZ)


@dataclass(frozen=True, kw_only=True)
class Audit:
    protocol: Protocol
    policies: tuple[str, ...]
    quick: bool
    parts: tuple[Part, ...]

    @property
    def passed(self) -> bool:
        return all(part.passed for part in self.parts)

    def as_json(self) -> dict[str, Any]:
        """Nothing in it depends on place, time or machine, where everything passed."""
        return {
            "schema": SCHEMA, "passed": self.passed, "quick": self.quick, "policies": list(self.policies),
            "protocol": {"id": self.protocol.id, "sha256": self.protocol.sha256, "body": self.protocol.person.body},
            "versions": package_versions(), "parts": [part.as_json() for part in self.parts],
        }  # fmt: skip


def audit(
    protocol: Protocol,
    policies: Sequence[PolicySetup],
    *,
    quick: bool,
    on_event: Callable[[str], None] = lambda said: None,
) -> Audit:
    """Run every part on every policy.

    The quick form presses one region with all that the policies ask for on one card; the full one presses every
    region of the protocol with each card, and lets the policies' own trials run to their end.

    Raises SceneError or SettleError where no world can be made, CarecontactError if the audit itself breaks.
    """
    seed = protocol.randomization.seeds[0] if protocol.randomization.seeds else 0
    tasks = list({task.region: task.id for task in reversed(protocol.tasks)}.values())[::-1]
    found: dict[str, list[Part]] = {}

    def add(part: Part) -> None:
        found.setdefault(part.name, []).append(part)

    with tempfile.TemporaryDirectory(prefix="carecontact-audit-") as name:
        folder, real = Path(name), list[Watched]()
        for number, task_id in enumerate(tasks[:1] if quick else tasks):
            logs, pressed = folder / "logs", list[Watched]()
            witness = folder / "witness"
            logs.mkdir()
            keyframe = Keyframe(protocol, task_id=task_id, seed=seed)
            region = protocol.task(task_id).region
            spec = TrialSpec(protocol=protocol, task_id=task_id, seed=seed, policy="")
            quiet = spec.model_copy(update={"protocol": canary.without_noise(protocol)})
            if number == 0:
                for index, policy in enumerate(policies):
                    on_event(f"a trial of {policy.ref}")
                    trial = watch(
                        _shortened(spec, policy, quick=quick), policy=policy.ref.text, prepare=keyframe.parked,
                        log=logs / f"real-{index:02d}", setup=policy,
                    )  # fmt: skip
                    add(schema.audit_schema([trial]))
                    trial.forget()
                    real.append(trial)
            cards = _cards(real, together=quick)
            for index, card in enumerate(cards):
                on_event(f"two presses on the {region.replace('_', ' ')}, seen by {card.name}")
                seldom, log = quick and bool(card.modalities), logs / f"press-{number}-{index:02d}"
                one, twin = _pair(
                    quiet, card, keyframe, actions_per_look=QUICK_ACTIONS_PER_LOOK if seldom else 1, folder=witness,
                    log=log,
                )  # fmt: skip
                add(canary.audit_canary(one, twin))
                add(handshake.audit_handshake(one, twin))
                pressed.append(one)
                if seldom:
                    # Only images cost time: the rest is looked at as often as in the full form.
                    pressed.append(_blind_press(quiet, keyframe, folder=witness, log=logs / f"blind-{log.name}"))
                one.forget()
            on_event("two starts, the arm at another angle")
            add(handshake.audit_start(*_starts(quiet, keyframe, folder=witness)))
            on_event(f"the world scrambled in contact with the {region.replace('_', ' ')}")
            add(frozen.audit_frozen(_at_contact(keyframe, spec), cards, instruction=protocol.task(task_id).prompt))
            on_event("all of it made again without a simulator")
            add(derivation.audit_derivation(logs, pressed))
            on_event("all that it was made of read and drawn again")
            add(readings.audit_readings(logs, [*(real if number == 0 else ()), *pressed]))
            # Hundreds of megabytes a region.
            shutil.rmtree(logs)
    parts = tuple(_merged(part.NAME, part.TITLE, found.get(part.NAME, [])) for part in PARTS)
    names = tuple(policy.ref.text for policy in policies)
    return Audit(protocol=protocol, policies=names, quick=quick, parts=parts)


def write(result: Audit, folder: Path) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "audit.json"
    path.write_text(json.dumps(result.as_json(), indent=2) + "\n")
    return path


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


def _cards(trials: Sequence[Watched], *, together: bool) -> list[PolicyCard]:
    """One card for each different request, named after the policies that make it; or one card for all of them."""
    asked: dict[tuple[tuple[str, ...], tuple[str, ...]], list[str]] = {}
    for trial in trials:
        card = trial.card
        if card is not None:
            wanted = (card.modalities, card.cameras if card.modalities else ())
            asked.setdefault(wanted, []).append(trial.policy)
    if together and asked:
        modalities = {m for wanted, _ in asked for m in wanted}
        cameras = {c for _, wanted in asked for c in wanted}
        names = [name for group in asked.values() for name in group]
        asked = {(_in_order(modalities, MODALITIES), _in_order(cameras, CAMERAS)): names}
    return [
        PolicyCard(name=", ".join(names), modalities=modalities, cameras=cameras, control_hz=CONTROL_HZ)
        for (modalities, cameras), names in asked.items()
    ]


def _in_order(wanted: set[str], order: Sequence[str]) -> tuple[str, ...]:
    return tuple(name for name in order if name in wanted)


def _pair(
    spec: TrialSpec, card: PolicyCard, keyframe: Keyframe, *, actions_per_look: int, folder: Path, log: Path
) -> tuple[Watched, Watched]:
    """The same press in two worlds that differ in what is hidden; the first one is logged."""
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


def _starts(spec: TrialSpec, keyframe: Keyframe, *, folder: Path) -> tuple[Watched, Watched]:
    """One step of two trials whose seeds lay the person's arm at different angles."""
    poses = keyframe.parked_pose[None]
    one = press(spec, card=BLIND, poses=poses, prepare=keyframe.parked, actions_per_look=1, folder=folder)
    other = canary.other_arm_angle(spec)
    return one, press(other, card=BLIND, poses=poses, prepare=_settled, actions_per_look=1, folder=folder)


def _settled(spec: TrialSpec) -> tuple[Simulation, Settled, str]:
    return settled_world(spec.protocol, task_id=spec.task_id, seed=spec.seed)


def _at_contact(keyframe: Keyframe, spec: TrialSpec) -> Simulation:
    """A world at the end of the press."""
    simulation, _, _ = keyframe.near(spec)
    steps = round(1 / CONTROL_HZ / simulation.model.opt.timestep)
    for pose in keyframe.poses:
        simulation.set_goal(pose, 1 / CONTROL_HZ)
        simulation.advance(steps)
    simulation.refresh()
    return simulation


def _merged(name: str, title: str, parts: Sequence[Part]) -> Part:
    """Without any part there is nothing that could have passed."""
    counts: Counter[str] = Counter()
    for part in parts:
        counts.update(part.counts)
    findings = tuple(finding for part in parts for finding in part.findings)
    return Part(name=name, title=title, counts=dict(counts) or {"policies that showed a card": 0}, findings=findings)

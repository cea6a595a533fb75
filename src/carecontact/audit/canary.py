"""Part (c): two worlds that differ only in hidden values give the same observations until the tool touches."""

from __future__ import annotations

import numpy as np

from carecontact.audit.differences import differences
from carecontact.audit.finding import Finding, Part
from carecontact.audit.schema import failed_at
from carecontact.audit.watched import Watched
from carecontact.contract.protocol import Protocol
from carecontact.contract.trial import TrialSpec
from carecontact.episode.drawn import draw
from carecontact.hosting.wire.packing import unpack

NAME, TITLE = "canary", "same observations until contact in worlds with different hidden values"
OTHER_SEED = 48_611
"""Added to the seed; no protocol uses such seeds."""
OTHER_ANGLES = 8
"""Number of seeds from which another angle of the arm is chosen."""
CONTROL = "scorer/force_human_from_robot_in_world"


def without_noise(protocol: Protocol) -> Protocol:
    """Return the protocol without sensor noise and errors of calibration: both are drawn from the seed by design, so
    that they would differ between the two worlds.
    """
    exact = {"depth_noise": "none", "encoder_noise_rad": 0.0, "calibration_m": 0.0, "calibration_deg": 0.0}
    quiet = protocol.variation.model_copy(update=exact)
    return protocol.model_copy(update={"variation": quiet})


def other_hidden_values(spec: TrialSpec) -> TrialSpec:
    """Return a trial that looks the same to a policy but has another seed, labels, thresholds, limits and tissue."""
    protocol, task = spec.protocol, spec.protocol.task(spec.task_id)
    renamed = task.model_copy(update={"id": "canary", "name": "Canary"})
    tissue = {
        region: row.model_copy(update={"a_n_m3": 2 * row.a_n_m3, "b_n_m4": 2 * row.b_n_m4, "c_n_m5": 2 * row.c_n_m5})
        for region, row in protocol.person.tissue.items()
    }
    contact, gates, limits = protocol.contact, protocol.gates, protocol.limits
    other = protocol.model_copy(
        update={
            "description": "canary",
            "person": protocol.person.model_copy(update={"tissue": tissue, "tissue_set": "canary"}),
            "tasks": [renamed if t.id == task.id else t for t in protocol.tasks],
            "contact": contact.model_copy(
                update={"on_n": 3 * contact.on_n, "valid_total_s": 2 * contact.valid_total_s}
            ),
            "gates": gates.model_copy(update={"region_share": gates.region_share / 2}),
            "limits": limits.model_copy(
                update={"gamma": limits.gamma / 2, "f_pain_n": {k: 1.5 * v for k, v in limits.f_pain_n.items()}}
            ),
        }
    )
    return spec.model_copy(update={"protocol": other, "task_id": "canary", "seed": spec.seed + OTHER_SEED})


def other_arm_angle(spec: TrialSpec, *, own_deg: float) -> TrialSpec:
    """Return the trial with a seed that lays the person's arm at an angle far from ``own_deg``, the angle of its own
    seed.

    Where the protocol parks the robot, ``own_deg`` may differ from the seed's first draw, because that person may have
    been refused.
    """
    region = spec.protocol.task(spec.task_id).region

    def away(seed: int) -> float:
        return abs(draw(spec.protocol, region=region, seed=seed, salt=spec.salt).comfort_arm_deg - own_deg)

    far = max(range(spec.seed + OTHER_SEED, spec.seed + OTHER_SEED + OTHER_ANGLES), key=away)
    return spec.model_copy(update={"seed": far})


def audit_canary(one: Watched, twin: Watched) -> Part:
    """Compare the observations of the same press in two worlds.

    ``one`` and ``twin``: what ``watched.press`` returned, with the observations still in memory.
    """
    findings = [
        Finding(policy=trial.policy, place=place, told=f"could not be run in the {which} world: {trial.error}")
        for which, trial in (("first", one), ("other", twin))
        if trial.error
        for place in failed_at(trial.error)
    ]
    counts = {"observations before contact": 0, "scorer samples that differ after contact": 0}
    if one.recording is not None and twin.recording is not None and not findings:
        forces = [trial.recording[CONTROL] for trial in (one, twin) if trial.recording is not None]
        steps = [np.flatnonzero(force.any((1, 2))) for force in forces]
        times = one.recording["scorer/time_s"]
        first = int(steps[0][0]) if len(steps[0]) else len(times)
        dt_s = one.recording.header.spec.protocol.physics.dt_s
        until_s = (first + 0.5) * dt_s
        for look, other in zip(one.looks, twin.looks, strict=False):
            if look.time_s > until_s:
                break
            counts["observations before contact"] += 1
            if look.sent == other.sent:
                continue
            told = differences(unpack(look.sent), unpack(other.sent), "message")
            at = f"at {look.time_s:.3f} s, before contact"
            findings += [
                Finding(
                    policy=one.policy, place=place.removeprefix("message."),
                    told=f"{at}: {what}, although the two worlds differ only in hidden values",
                )
                for place, what in told or [("message", "the same values are packed in other bytes")]
            ]  # fmt: skip
        if len(steps[1]) and int(steps[1][0]) != first:
            told = f"first contact at step {first} in one world and {int(steps[1][0])} in the other"
            findings.append(
                Finding(
                    policy=one.policy, place="trial", told=f"{told}: the two worlds already differed before contact"
                )
            )
        after = [force[first:] for force in forces]
        length = min(map(len, after))
        counts["scorer samples that differ after contact"] = int(
            (after[0][:length] != after[1][:length]).any((1, 2)).sum()
        )
        if not counts["scorer samples that differ after contact"]:
            told = "is the same in both worlds after contact: the other hidden values had no effect"
            findings.append(Finding(policy=one.policy, place=CONTROL, told=f"{told}, so this part proves nothing"))
    return Part(name=NAME, title=TITLE, counts=counts, findings=tuple(findings))

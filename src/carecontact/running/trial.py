"""One trial: the conversation of a policy with an episode, and the look at its first answer."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np
import numpy.typing as npt

from carecontact.episode.episode import Episode
from carecontact.episode.randomization import World
from carecontact.errors import ActionError, ExhaustedError, PolicyError, UnreachableError
from carecontact.interface.action import NEAR_BASE_M, Action
from carecontact.interface.geometry import matrix_from_quat
from carecontact.interface.observation import Observation
from carecontact.policies.registry import is_privileged
from carecontact.protocol.protocol import TrialSpec
from carecontact.recording.schema import Recording
from carecontact.running.engine import check_setup, setup_of
from carecontact.running.pace import Pace
from carecontact.sensing.builder import RawReadings
from carecontact.serving.codec import act_message
from carecontact.serving.conversation import PolicyConversation, PolicySetup
from carecontact.serving.opening import open_policy

# One line of a check.

Level = Literal["ok", "warning", "error", "hint", "wait"]


@dataclass(frozen=True, kw_only=True)
class CheckFinding:
    level: Level
    topic: str
    text: str
    """Text, whose first line stands beside level and topic, and whose other lines stand below it."""


# What a policy's first answer reveals about common mistakes: poses as differences, quaternion order, gripper polarity.
#
# None of these breaks the contract, so a trial would run and fail for a reason that no score names.

F64 = npt.NDArray[np.float64]

FAR_M = 0.25
"""Distance of a first target from the tool that counts as far: a second of the fastest motion."""
WRONG_TURN_DEG, RIGHT_TURN_DEG = 90.0, 45.0
"""A first target that turns the tool by more, and by less if its quaternion is read as x y z w, has the other order."""
HALF_OPEN = 0.5


def look_at(actions: Sequence[Action], observation: Observation) -> list[CheckFinding]:
    """Return warnings about an answer. A pose that the trial will refuse gives none: the refusal says more."""
    poses = [action.pose_tcp_in_base for action in actions if _is_pose(action.pose_tcp_in_base)]
    found = [*_gripper(actions, observation), *_end(actions)]
    if poses:
        first = np.asarray(poses[0], np.float64)
        found += [*_position(first, observation.pose_tcp_in_base), *_orientation(first, observation.pose_tcp_in_base)]
    return found


def _is_pose(given: F64 | None) -> bool:
    return given is not None and given.shape == (7,) and bool(np.isfinite(given).all()) and bool(given[3:].any())


def _position(target: F64, tool: F64) -> Iterator[CheckFinding]:
    place, distance = target[:3], float(np.linalg.norm(target[:3] - tool[:3]))
    where = f"the first target is at {_numbers(place)} m and the tool at {_numbers(tool[:3])} m in base"
    if np.linalg.norm(place) < NEAR_BASE_M:
        yield CheckFinding(
            level="warning", topic="difference", text=f"{where}: send absolute poses of the tool, not differences to it"
        )
    elif distance > FAR_M:
        yield CheckFinding(
            level="warning",
            topic="position",
            text=f"{where}, {distance:.2f} m away: check frame (base of the robot) and unit (metres)",
        )


def _orientation(target: F64, tool: F64) -> Iterator[CheckFinding]:
    as_sent, reordered = _angle_deg(target[3:], tool[3:]), _angle_deg(np.roll(target[3:], 1), tool[3:])
    if as_sent <= WRONG_TURN_DEG:
        return
    if reordered < RIGHT_TURN_DEG:
        text = f"the first target turns the tool by {as_sent:.0f} degrees, or by {reordered:.0f} if x y z w was meant"
        yield CheckFinding(level="warning", topic="quaternion", text=f"{text}: send quaternions in the order w x y z")
    else:
        text = f"the first target turns the tool by {as_sent:.0f} degrees: its z axis points out of the tool"
        yield CheckFinding(level="warning", topic="orientation", text=text)


def _gripper(actions: Sequence[Action], observation: Observation) -> Iterator[CheckFinding]:
    opened = [action.gripper for action in actions if action.gripper is not None and action.gripper > HALF_OPEN]
    reads = float(observation.gripper_position[0])
    if opened and reads < HALF_OPEN:
        text = (
            f"the answer commands {opened[0]:g} while the gripper reads {reads:g}: here "
            "1 is open and 0 is closed (DROID and openpi have 1 for closed); send 1 - g if your policy means closed"
        )
        yield CheckFinding(level="warning", topic="gripper", text=text)


def _end(actions: Sequence[Action]) -> Iterator[CheckFinding]:
    if actions[0].done:
        yield CheckFinding(
            level="warning", topic="done", text="the first action ends the trial, before the robot moves"
        )


def _angle_deg(a: F64, b: F64) -> float:
    turn = matrix_from_quat(a / np.linalg.norm(a)).T @ matrix_from_quat(b / np.linalg.norm(b))
    return float(np.degrees(np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1))))


def _numbers(values: F64) -> str:
    return " ".join(f"{value:.2f}" for value in values)


# Run one trial: a policy in conversation with an episode.

ISOLATION = "wall/isolation"
"""Array of a recording with the description of how far its policy's process was isolated, as UTF-8."""


@dataclass(frozen=True, kw_only=True)
class Look:
    """One observation as the audit is shown it, after the policy has answered."""

    observation: Observation
    actions: list[Action]
    """The answer."""
    raw: RawReadings
    sent: bytes
    """The message in which the policy received it."""


def run_trial(
    spec: TrialSpec,
    *,
    policy: PolicySetup | None = None,
    weights: Path | None = None,
    pace_s: float | None = None,
    prepare: Callable[[TrialSpec], World] | None = None,
    on_look: Callable[[Look], None] | None = None,
    on_policy: Callable[[bool], None] | None = None,
    on_wait: Callable[[str], None] | None = None,
    on_sent: Callable[[bytes], None] | None = None,
) -> Recording:
    """Run the trial to its end; a policy's failure is part of the recording.

    Args:
        policy: how the trial's policy is reached; by default as its name in ``spec`` alone says.
        weights: folder with the weights of the protocol's segmenter.
        pace_s: wall time [s] for each control period, as the policy sees it (``trials.pace``); None: as fast as can be.
        prepare: gives the world at t = 0, as ``settled_world`` does; the audit has its own.
        on_look: called after every answer with what the policy was shown and what it was made of.
        on_policy: called with True when the process of a local policy is about to start, with False when it is gone.
        on_wait: called with a line every few seconds while the policy is silent, by another thread.
        on_sent: called with every message that is sent to the policy.

    Raises:
        UnreachableError: the policy's server took no connection until the deadline of its start.
        CarecontactError: the harness itself failed (SceneError, SettleError, DependencyError and others).
    """
    setup = policy or setup_of(spec)
    check_setup(spec, setup)
    report = on_policy if on_policy is not None and setup.ref.kind != "remote" else _report_to_nobody
    with Episode(spec, prepare=prepare, weights=weights) as episode:
        if is_privileged(setup.ref):
            # Here, because a trial of another policy needs nothing of it.
            from carecontact.oracle.policy import drive

            drive(episode, setup.ref)
            return episode.finish()
        report(True)
        try:
            _converse(episode, setup, Pace(pace_s), on_look, on_wait, on_sent)
        except ExhaustedError:
            if ISOLATION not in episode.log.extra:
                # Nothing of the policy has run.
                report(False)
            raise
        report(False)
        return episode.finish()


def _report_to_nobody(running: bool) -> None:
    pass


def _converse(
    episode: Episode,
    setup: PolicySetup,
    pace: Pace,
    on_look: Callable[[Look], None] | None,
    on_wait: Callable[[str], None] | None,
    on_sent: Callable[[bytes], None] | None,
) -> None:
    phases = episode.protocol.phases
    try:
        with open_policy(
            setup, first_deadline_s=phases.first_call_deadline_s, deadline_s=phases.call_deadline_s
        ) as policy:
            policy.on_wait, policy.on_sent, policy.patient = on_wait, on_sent, True
            try:
                episode.card = policy.start()
                policy.reset(episode.instruction, episode.session)
                _act(episode, policy, pace, on_look)
            finally:
                # What it printed may hold times and paths, so it is evidence but no part of the recording's hash.
                policy.close()
                episode.log.extra.update(pace.arrays())
                episode.log.extra["wall/policy_output"] = np.frombuffer(policy.printed.encode(), "u1")
                if policy.isolation is not None:
                    episode.log.extra[ISOLATION] = np.frombuffer(policy.isolation.encode(), "u1")
    except UnreachableError:
        raise
    except PolicyError as error:
        episode.fail(error)


def _act(episode: Episode, policy: PolicyConversation, pace: Pace, on_look: Callable[[Look], None] | None) -> None:
    observation: Observation | None = episode.reset()
    while observation is not None:
        pace.hold(partial(act_message, observation))
        reply = policy.act(observation)
        pace.answered(len(reply.actions))
        episode.answered(sent_sha256=reply.sent_sha256, notes=reply.notes)
        if on_look is not None and episode.raw is not None:
            on_look(Look(observation=observation, actions=reply.actions, raw=episode.raw, sent=reply.sent))
        observation = None
        for number, action in enumerate(reply.actions):
            try:
                step = episode.step(action, observe=number + 1 == len(reply.actions))
            except ActionError as error:
                policy.refuse(number, error)
            if step.reason is not None:
                return
            observation = step.observation

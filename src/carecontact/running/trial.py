"""One trial: the conversation of a policy with an episode."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from carecontact.episode.episode import Episode, Teaching
from carecontact.episode.randomization import World
from carecontact.errors import ActionError, ExhaustedError, PolicyError, UnreachableError
from carecontact.interface.action import Action
from carecontact.interface.observation import Observation
from carecontact.interface.policy import LOOK_CONTROLS
from carecontact.policies.registry import is_privileged
from carecontact.protocol.protocol import TrialSpec
from carecontact.recording.schema import Recording
from carecontact.running.engine import check_setup, setup_of
from carecontact.running.pace import Pace
from carecontact.sensing.builder import RawReadings
from carecontact.serving.codec import act_message
from carecontact.serving.conversation import PolicyConversation, PolicySetup
from carecontact.serving.opening import open_policy

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
        pace_s: wall time [s] for each control period, as the policy sees it; None: as fast as can be.
        prepare: gives the world at t = 0, as ``settled_world`` does; the audit has its own.
        on_look: called after every answer with what the policy was shown and what it was made of.
        on_policy: called with True when the process of a local policy is about to start, with False when it is gone.
        on_wait: called with a line every few seconds while the policy is silent, by another thread.
        on_sent: called with every message that is sent to the policy.
    """
    setup = policy or setup_of(spec)
    check_setup(spec, setup)
    report = on_policy if on_policy is not None and setup.ref.kind != "remote" else lambda running: None
    with Episode(spec, prepare=prepare, weights=weights) as episode:
        variant = setup.ref.variant
        episode.privileged, episode.control = variant == "dagger", variant if variant in LOOK_CONTROLS else ""
        if is_privileged(setup.ref):
            # Here, because a trial of another policy needs nothing of it.
            from carecontact.oracle.policy import drive

            drive(episode, setup.ref, lambda: _teaching(episode, setup))
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
                _act(episode, policy, pace, on_look, lambda: _teaching(episode, setup))
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


def _teaching(episode: Episode, setup: PolicySetup) -> Teaching:
    """Return what turns the policy's actions into demonstrations, in an episode that has begun."""
    if setup.ref.variant in ("", *LOOK_CONTROLS):
        return lambda action: (action, None)
    # Here, because a trial of another policy needs nothing of it.
    from carecontact.oracle.teaching import teaching_of

    return teaching_of(setup.ref.variant, episode)


def _act(
    episode: Episode,
    policy: PolicyConversation,
    pace: Pace,
    on_look: Callable[[Look], None] | None,
    prepared: Callable[[], Teaching],
) -> None:
    observation: Observation | None = episode.reset()
    teach = prepared()
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
                executed, demonstrated = teach(action)
                more = {"observe": number + 1 == len(reply.actions), "demonstrated": demonstrated}
                step = episode.step(executed, **more)
            except ActionError as error:
                policy.refuse(number, error)
            if step.reason is not None:
                return
            observation = step.observation

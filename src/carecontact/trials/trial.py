"""Run one trial: a policy in conversation with an episode."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from carecontact.contract.observation import Observation
from carecontact.contract.policy_address import remote_address
from carecontact.contract.trial import TrialSpec
from carecontact.episode.episode import Episode
from carecontact.episode.prepare import World
from carecontact.errors import ActionError, PolicyError
from carecontact.hosting.conversation import PolicyConversation
from carecontact.hosting.opening import open_policy
from carecontact.observation.builder import RawReadings
from carecontact.recording.schema import Recording
from carecontact.runs.identity import POLICY_PATH


@dataclass(frozen=True, kw_only=True)
class Look:
    """One observation as the audit is shown it, after the policy has answered."""

    observation: Observation
    raw: RawReadings
    sent: bytes
    """The message in which the policy received it."""


def run_trial(
    spec: TrialSpec,
    *,
    search_path: Sequence[str] | None = None,
    prepare: Callable[[TrialSpec], World] | None = None,
    on_look: Callable[[Look], None] | None = None,
    on_policy: Callable[[bool], None] | None = None,
) -> Recording:
    """Run the trial to its end; a policy's failure is part of the recording.

    Args:
        search_path: folders in which ``module:Class`` is looked for first.
        prepare: gives the world at t = 0, as ``settled_world`` does; the audit has its own.
        on_look: called after every answer with what the policy was shown and what it was made of.
        on_policy: called with True when the process of a local policy is about to start, with False when it is gone.

    Raises:
        CarecontactError: the harness itself failed (SceneError, SettleError, DependencyError and others).
    """
    if search_path is None:
        search_path = [p for p in os.environ.get(POLICY_PATH, "").split(os.pathsep) if p]
    local = on_policy is not None and remote_address(spec.policy) is None
    with Episode(spec, prepare=prepare) as episode:
        if on_policy is not None and local:
            on_policy(True)
        _converse(episode, list(search_path), on_look)
        if on_policy is not None and local:
            on_policy(False)
        return episode.finish()


def _converse(episode: Episode, search_path: list[str], on_look: Callable[[Look], None] | None) -> None:
    phases = episode.protocol.phases
    try:
        with open_policy(
            episode.spec.policy, first_deadline_s=phases.first_call_deadline_s, deadline_s=phases.call_deadline_s,
            search_path=search_path,
        ) as policy:  # fmt: skip
            try:
                episode.card = policy.start()
                policy.reset(episode.instruction, episode.session)
                _act(episode, policy, on_look)
            finally:
                # What it printed may hold times and paths, so it is evidence but no part of the recording's hash.
                policy.close()
                episode.log.extra["wall/policy_output"] = np.frombuffer(policy.printed.encode(), "u1")
    except PolicyError as error:
        episode.fail(error)


def _act(episode: Episode, policy: PolicyConversation, on_look: Callable[[Look], None] | None) -> None:
    observation: Observation | None = episode.reset()
    while observation is not None:
        reply = policy.act(observation)
        episode.answered(sent_sha256=reply.sent_sha256, notes=reply.notes)
        if on_look is not None and episode.raw is not None:
            on_look(Look(observation=observation, raw=episode.raw, sent=reply.sent))
        observation = None
        for number, action in enumerate(reply.actions, start=1):
            try:
                step = episode.step(action, observe=number == len(reply.actions))
            except ActionError as error:
                raise PolicyError("action", str(error)) from None
            if step.reason is not None:
                return
            observation = step.observation

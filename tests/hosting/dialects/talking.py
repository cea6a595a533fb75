"""A conversation with a fake server, as a trial has it, but with observations that nothing was rendered for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from carecontact.contract.observation import CameraView, Observation
from carecontact.contract.policy_ref import PolicyRef
from carecontact.hosting.client import ActReply
from carecontact.hosting.remote import RemotePolicy
from carecontact.hosting.setup import PolicySetup
from tests.hosting.dialects.given import picture
from tests.policies.synthetic import SESSION, synthetic_observation

INSTRUCTION = "gently touch the right forearm"
JOINTS = np.array([0.5, -0.4, 0.4, -1.8, 0.1, 1.5, 1.1])


def view(height: int, width: int) -> CameraView:
    return CameraView(intrinsics=np.eye(3), pose_camera_in_base=np.eye(4), rgb=picture(height, width))


def seen() -> Observation:
    """What the cameras of bathing-v3-draft would show, in size: every picture other than the others."""
    cameras = {"exterior": view(360, 640), "wrist": view(480, 640), "bedside": view(482, 640)}
    return replace(synthetic_observation(cameras=cameras), instruction=INSTRUCTION, joint_position=JOINTS)


def policy_at(address: str, *, key: str = "", deadline_s: float = 20.0) -> RemotePolicy:
    ref = replace(PolicyRef.parse(address), credentials=key)
    return RemotePolicy(PolicySetup(ref=ref), first_deadline_s=deadline_s, deadline_s=deadline_s)


def talk(address: str, *, calls: int = 3, key: str = "", deadline_s: float = 20.0) -> list[ActReply]:
    """What a server answers to the same observation again and again."""
    with policy_at(address, key=key, deadline_s=deadline_s) as policy:
        policy.start()
        policy.reset(INSTRUCTION, SESSION)
        return [policy.act(seen()) for _ in range(calls)]


def joints(replies: list[ActReply]) -> np.ndarray:
    """(n, 7) of all actions that would be executed."""
    given = [action.joint for reply in replies for action in reply.actions]
    return np.array([joint for joint in given if joint is not None])

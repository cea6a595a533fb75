"""The information that a policy receives before its first observation."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class ActionBounds:
    """Limits that a policy learns before its first action."""

    workspace_low_m: tuple[float, float, float]
    workspace_high_m: tuple[float, float, float]
    """Box of TCP positions in base."""
    translational_stiffness: tuple[float, float]
    rotational_stiffness: tuple[float, float]


@dataclass(frozen=True, kw_only=True)
class Session:
    """What holds for every trial of a protocol: limits and cameras. Carries no seed, task id or label."""

    action_bounds: ActionBounds
    joint_low_rad: tuple[float, ...]
    """(joints,) lower joint limits of the robot"""
    joint_high_rad: tuple[float, ...]
    """(joints,)"""
    camera_sizes_px: dict[str, tuple[int, int]]
    """Camera -> (width, height) [px], for every camera of the scene, whether the card requests it or not."""
    time_limit_s: float

"""The robot that every trial has."""

from __future__ import annotations

EMBODIMENT = "panda-closed-gripper-caps"

"""What the policy declared about itself, and what of the views that it requested a page cannot show."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from carecontact.contract.control import CARTESIAN_IMPEDANCE
from carecontact.recording.schema import Header, Recording
from carecontact.reports.trial.looks import FRAMES

KEPT = ("rgb", "depth")
"""Modalities of which a recording keeps the images."""


def card_rows(header: Header) -> list[tuple[str, str]]:
    """Return the policy's card as (field, text); empty where the policy failed before it had sent one."""
    card: Mapping[str, Any] = header.card or {}
    rows = [("Name", str(card["name"]))] if "name" in card else []
    if cameras := card.get("cameras"):
        modalities = ", ".join(card.get("modalities", ())) or "no image, only where each stands and how it projects"
        rows.append(("Cameras", f"{', '.join(cameras)}: {modalities}"))
    if "control_hz" in card:
        rows.append(("Control rate", f"{card['control_hz']:g} actions a second"))
    if "action_space" in card:
        rows.append(("Action space", f"{card['action_space']}, executed by {card.get('control', CARTESIAN_IMPEDANCE)}"))
    if card.get("out_of_bounds") == "clip":
        rows.append(("Workspace", "a target outside it is moved onto its border"))
    if (language := str(card.get("language_backend", "none"))) != "none":
        rows.append(("Language", language))
    if arguments := card.get("arguments"):
        rows.append(("Arguments", " ".join(f"{name}={text}" for name, text in sorted(arguments.items()))))
    if variables := card.get("environment"):
        rows.append(("Environment variables", " ".join(map(str, variables))))
    return rows


def not_shown_text(recording: Recording, left_out: int) -> str:
    """Return sentences on what the policy saw and the page does not show; empty where the page shows everything.

    Args:
        left_out: number of stored pictures that the page leaves out.
    """
    card = recording.header.card or {}
    told: list[str] = []
    if others := [str(name) for name in card.get("modalities", ()) if name not in KEPT]:
        those = others[0] if len(others) == 1 else f"{', '.join(others[:-1])} and {others[-1]}"
        told.append(f"The policy was also sent {those} at each look; a recording keeps only colour and depth images.")
    images = [name for name in card.get("modalities", ()) if name in KEPT]
    sent = len(recording["policy/observation_time_s"]) * len(images) * len(card.get("cameras", ()))
    stored = sum(path.startswith(FRAMES) for path in recording.arrays)
    if left_out:
        verb = "is" if left_out == 1 else "are"
        told.append(f"{_pictures(left_out, 'stored')} of later looks {verb} not on this page.")
    if (lost := sent - stored) > 0:
        told.append(f"{_pictures(lost, 'further')} of later looks {'was' if lost == 1 else 'were'} not stored.")
    return " ".join(told)


def _pictures(count: int, kind: str) -> str:
    return f"{count} {kind} picture{'' if count == 1 else 's'}"

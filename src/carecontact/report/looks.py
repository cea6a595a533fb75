"""What the policy saw at each look, what it noted, how long it took to answer, what it commanded, and its card."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from carecontact.interface.robot import CARTESIAN_IMPEDANCE
from carecontact.recording.notes import Note
from carecontact.recording.pictures import KEPT, Key, Pictures
from carecontact.recording.schema import Header, Recording
from carecontact.report.svg import jpeg_data_uri

MOST_PICTURES = 24
"""Pictures of all looks together that the page shows."""
PICTURE_WIDTH = 400
MAX_NOTE_CHARS = 12_000
"""Longest text that the page shows of the notes of one look."""
DEPTH_M = (0.3, 2.0)
VIRIDIS = (
    (68, 1, 84), (71, 45, 123), (59, 82, 139), (44, 114, 142), (33, 145, 140), (39, 173, 129), (92, 200, 99),
    (170, 220, 50), (253, 231, 37),
)  # fmt: skip
"""Nine equally spaced colours of matplotlib's map of this name (CC0)."""
"""Range of a depth image's colours."""


@dataclass(frozen=True, kw_only=True)
class Picture:
    name: str
    uri: str


@dataclass(frozen=True, kw_only=True)
class Look:
    number: int
    time_s: float | None
    """None: the policy failed before it had answered."""
    answered_after_s: float | None
    """Wall time; None where the recording does not say."""
    actions: str
    pictures: tuple[Picture, ...]
    headline: tuple[tuple[str, str], ...]
    """Name and text of each note that is short."""
    notes: str
    """All notes as JSON; empty if there are none."""
    arrays: str
    """Arrays among the notes, with their shapes."""


def looks_of(recording: Recording, notes: Sequence[Note]) -> tuple[list[Look], int]:
    """Return the looks in their order, and the number of stored pictures that the page leaves out."""
    times = recording["policy/observation_time_s"]
    took = recording.arrays.get("wall/act_s", np.zeros(0))
    answers = recording["actions/observation_index"]
    noted = {note.observation_index: note for note in notes}
    pictures, stored = Pictures(recording), dict[int, list[Key]]()
    for key in pictures:
        stored.setdefault(key[0], []).append(key)
    count = max([len(times), *(index + 1 for index in (*noted, *stored))])
    left, out = MOST_PICTURES, list[Look]()
    rated = bool((recording.header.card or {}).get("camera_hz"))
    for number in range(count):
        if rated and number < len(times) and number not in stored and number not in noted:
            # Between two views, this policy received the encoders alone.
            continue
        frames = stored.get(number, [])[:left]
        left -= len(frames)
        note = noted.get(number)
        of_look = np.flatnonzero(answers == number)
        out.append(
            Look(
                number=number,
                time_s=float(times[number]) if number < len(times) else None,
                answered_after_s=float(took[number]) if number < len(took) else None,
                actions=_actions_text(recording, of_look),
                pictures=tuple(_picture(pictures, key) for key in frames),
                headline=() if note is None else _headline(note),
                notes="" if note is None else _as_json(note),
                arrays="" if note is None else ", ".join(f"{k} {v.shape}" for k, v in sorted(note.arrays.items())),
            )
        )
    return out, len(pictures) - (MOST_PICTURES - left)


def _picture(pictures: Pictures, key: Key) -> Picture:
    (_, camera, modality), image = key, pictures[key]
    colours = _coloured(image) if modality == "depth" and image.ndim == 2 else image
    return Picture(name=f"{camera}, {modality}", uri=jpeg_data_uri(colours, max_width=PICTURE_WIDTH))


def _coloured(depth_m: npt.NDArray[Any]) -> npt.NDArray[np.uint8]:
    """(H, W) [m] -> (H, W, 3) u1 from near (bright) to far (dark); black where there is no value."""
    low, high = DEPTH_M
    known = np.isfinite(depth_m)
    share = np.clip((high - np.where(known, depth_m, high)) / (high - low), 0, 1)
    places = np.linspace(0, 1, len(VIRIDIS))
    colours = np.stack([np.interp(share, places, channel) for channel in np.transpose(VIRIDIS)], -1)
    return np.where(known[..., None], colours, 0).astype(np.uint8)


def _headline(note: Note) -> tuple[tuple[str, str], ...]:
    """Texts and small numbers, which say most of a step; the rest is in the JSON."""
    short = [(name, _short(value)) for name, value in sorted(note.content.items())]
    return tuple((name.replace("_", " "), text) for name, text in short if text)


def _short(value: object) -> str:
    if isinstance(value, bool | int | float | str):
        return str(value) if len(str(value)) <= 160 else ""
    text = json.dumps(value)
    return text if len(text) <= 70 else ""


def _as_json(note: Note) -> str:
    text = json.dumps(note.content, indent=1, sort_keys=True, ensure_ascii=False)
    more = len(text) - MAX_NOTE_CHARS
    return text if more <= 0 else f"{text[:MAX_NOTE_CHARS]}\n… {more} more characters"


def _actions_text(recording: Recording, of_look: npt.NDArray[np.intp]) -> str:
    if not of_look.size:
        return "no action was executed"
    start, stop = recording["actions/time_s"][of_look[[0, -1]]].tolist()
    if of_look.size == 1:
        return f"1 action at {start:.2f} s"
    return f"{of_look.size} actions from {start:.2f} to {stop:.2f} s"


def action_rows(recording: Recording) -> list[tuple[str, ...]]:
    """Return time, look, target and stiffness of all executed actions; the target is joints, or the position in the
    robot's base [m]."""
    pose, stiffness = recording["actions/pose_tcp_in_base"], recording["actions/stiffness"]
    joint, clipped = recording.arrays.get("actions/joint"), recording.arrays.get("actions/clipped")
    rows: list[tuple[str, ...]] = []
    for i, time_s in enumerate(recording["actions/time_s"].tolist()):
        if joint is not None:
            target = " ".join(f"{v:.3f}" for v in joint[i])
        else:
            target = "kept" if np.isnan(pose[i, :3]).any() else " ".join(f"{v:.4f}" for v in pose[i, :3])
        if clipped is not None and clipped[i]:
            target += ", moved onto the border"
        look = str(int(recording["actions/observation_index"][i]))
        rows.append((f"{time_s:.2f}", look, target, " / ".join(f"{v:g}" for v in stiffness[i])))
    return rows


def _rate(hz: float) -> str:
    return f" at {hz:g} Hz" if hz else " (once, and when an action asks)"


def card_rows(header: Header) -> list[tuple[str, str]]:
    """Return the policy's card as (field, text); empty where the policy failed before it had sent one."""
    card: Mapping[str, Any] = header.card or {}
    rows = [("Name", str(card["name"]))] if "name" in card else []
    if cameras := card.get("cameras"):
        modalities = ", ".join(card.get("modalities", ())) or "no image, only where each stands and how it projects"
        rates = card.get("camera_hz", {})
        shown = [f"{name}{_rate(rates[name])}" if name in rates else str(name) for name in cameras]
        rows.append(("Cameras", f"{', '.join(shown)}: {modalities}"))
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


def sent_views(recording: Recording) -> dict[str, Any]:
    """Return the modalities that the policy was sent and a recording does not keep, and the number of pictures of later
    looks that this recording did not store."""
    card = recording.header.card or {}
    modalities = [str(name) for name in card.get("modalities", ())]
    images = sum(name in KEPT for name in modalities)
    views = len(recording["policy/observation_time_s"]) * len(card.get("cameras", ()))
    if "policy/looked" in recording:
        views = int(recording["policy/looked"].sum())
    lost = max(views * images - len(Pictures(recording)), 0)
    return {"others": [name for name in modalities if name not in KEPT], "lost": lost}

"""Demonstrations as a learner reads them: what the person looked like, where the tool was, and where it was sent.

Recordings are closed to policies: what reads them is imported where they are read, since a policy imports this file.
"""

from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from carecontact.errors import CarecontactError
from carecontact.interface.geometry import pose_matrix, quat_from_matrix
from carecontact.interface.observation import Observation
from carecontact.interface.policy import PolicyCard
from carecontact.policies.point_flow import HZ


@dataclass(frozen=True, kw_only=True)
class Demonstration:
    looks: list[Observation]
    """What a policy with the learner's card would have been sent at each multiple of the period of its looks."""
    tool: np.ndarray
    """(N, 7) pose of the tool in base at the time of each target."""
    given: np.ndarray
    """(N, 7) targets that were executed."""
    wanted: np.ndarray
    """(N, 7) targets that the demonstrator wanted: with noise or labels, not those that were executed."""
    salt: str
    """sha256 of the salt that drew the person, for a card's ``trained_on``."""


def passed(folders):
    """Return the recordings of all demonstrations in some folders that passed their gate safely."""
    from carecontact.runs.scoring import read_scores

    return [
        Path(folder) / f"{score.trial_id}.h5"
        for folder in folders
        for score in read_scores(Path(folder)).scores
        if score.safety_gated
    ]


def each(work, folders, jobs=None):
    """Return what ``work`` makes of each recording of ``passed``, in ``jobs`` processes, by default one per core.
    Raises SystemExit if no demonstration passed."""
    try:
        recordings = passed(folders)
    except CarecontactError as error:
        raise SystemExit(f"error: {error}") from None
    if not recordings:
        raise SystemExit(f"error: no demonstration in {', '.join(map(str, folders))} passed safely")
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
        return list(pool.map(work, recordings))


def demonstration(path, card: PolicyCard, looks_hz=None):
    """Return a recorded Demonstration with a look at t = 0, and more of them at ``looks_hz``."""
    from carecontact.recording import read_recording
    from carecontact.replay.dataset import Resensed

    recording = read_recording(path)
    looks = Resensed(recording, card).observations(looks_hz or HZ)
    looks = list(looks) if looks_hz else [next(looks)]
    base = recording.header.pose_base_in_world
    to_base = np.linalg.inv(pose_matrix(np.array(base[:3]), np.array(base[3:])))
    at = np.searchsorted(recording["scorer/time_s"], recording["actions/time_s"] - 1e-9)
    poses = [to_base @ pose_matrix(p[:3], p[3:]) for p in recording["scorer/pose_tcp_in_world"][at].astype(float)]
    tool = np.array([np.append(pose[:3, 3], quat_from_matrix(pose[:3, :3])) for pose in poses])
    given = wanted = _held(recording["actions/pose_tcp_in_base"], tool[0])
    if "actions/demonstrated" in recording:
        wanted = _held(recording["actions/demonstrated"][:, :7], tool[0])
    return Demonstration(looks=looks, tool=tool, given=given, wanted=wanted, salt=recording.header.spec.commitment)


def _held(poses, before):
    """(N, 7) targets, each the one before where an action kept it."""
    out = np.vstack([before, poses])
    for k in range(1, len(out)):
        out[k] = out[k - 1] if np.isnan(out[k, 0]) else out[k]
    return out[1:]

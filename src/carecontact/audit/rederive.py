"""The process of part (a): makes every byte that was sent again from the log, where no simulator can be imported."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

from carecontact.audit.finding import within_reach
from carecontact.audit.raw_log import (
    SAME,
    LoggedLook,
    Meta,
    intrinsics,
    message_differences,
    pose_camera_in_base,
    pose_hand_in_base,
    read_looks,
    read_meta,
)
from carecontact.errors import CarecontactError
from carecontact.sensing.builder import RawReadings, derive
from carecontact.sensing.keypoints import KeypointEstimator, PoseEstimator
from carecontact.serving.sent_message import dialect_of, rebuilt_message, unpacked_message

REDERIVE_BOOTSTRAP = """
import sys
sys.path.insert(0, sys.argv[1])
from carecontact.audit.finding import refuse_simulators
refuse_simulators()
from carecontact.audit.rederive import main
main(sys.argv[2])
"""
"""Program for ``python -c``. Its arguments are the folder of the package and that of the trial logs (``raw_log``)."""


def main(folder: str) -> None:
    """Print one JSON object: ``looks`` of every trial (``rederive_trial``), and ``simulators``, those within reach."""
    keypoints = PoseEstimator()
    trials = sorted(path for path in Path(folder).iterdir() if path.is_dir())
    looks = [row for trial in trials for row in rederive_trial(trial, keypoints)]
    sys.stdout.write(json.dumps({"looks": looks, "simulators": within_reach()}) + "\n")


def rederive_trial(folder: Path, keypoints: KeypointEstimator) -> list[dict[str, Any]]:
    """Return one row for each observation, with ``differences`` as pairs of a place and what differs there."""
    meta = read_meta(folder)
    return [
        {
            "trial": folder.name,
            "policy": meta.policy,
            "time_s": look.sim_time_s,
            "bytes": len(look.sent),
            "differences": [*_misplaced(look.raw, meta), *_changed(look, meta, keypoints)],
        }
        for look in read_looks(folder)
    ]


def _changed(look: LoggedLook, meta: Meta, keypoints: KeypointEstimator) -> list[tuple[str, str]]:
    """Return where the message differs, in any bit, from what the logged readings give."""
    try:
        shown = {"instruction": meta.instruction, "sim_time_s": look.sim_time_s, "modalities": meta.modalities}
        observation = derive(look.raw, keypoints=keypoints, **shown)
        again = rebuilt_message(observation, meta.arguments, meta.cameras, sent=look.sent)
    except CarecontactError as error:
        return [("observation", f"could not be recomputed: {error}")]
    if again == look.sent:
        return []
    dialect = dialect_of(meta.arguments)
    return message_differences(unpacked_message(again, dialect), unpacked_message(look.sent, dialect))


def _misplaced(raw: RawReadings, meta: Meta) -> list[tuple[str, str]]:
    """Return the poses and intrinsic matrices that differ from what calibration and encoders give."""
    hand, tcp_in_hand = pose_hand_in_base(meta.cell["arm"], raw.joint_position), np.eye(4)
    tcp_in_hand[:3, 3] = meta.tcp_in_hand_m
    rows = [("pose_tcp_in_base", raw.pose_tcp_in_base, hand @ tcp_in_hand)]
    for name, view in raw.views.items():
        camera, place = meta.cell["cameras"][name], f"cameras.{name}"
        rows.append((f"{place}.intrinsics", view.intrinsics, intrinsics(camera)))
        believed = pose_camera_in_base(camera, meta.cell, hand) @ np.array(meta.calibration.get(name, np.eye(4)))
        rows.append((f"{place}.pose_camera_in_base", view.pose_camera_in_base, believed))
    out: list[tuple[str, str]] = []
    for place, logged, known in rows:
        away = float(np.abs(logged - known).max())
        if not away <= SAME * max(1.0, float(np.abs(known).max())):
            out.append((f"observation.{place}", f"deviates by {away:.3g} from what calibration and encoders give"))
    return out

"""The recorded quantities that Rerun plots, by entity path: from the recording alone."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from carecontact.contract.geometry import matrix_from_quat
from carecontact.recording.schema import Recording
from carecontact.regions import REGIONS

HZ = 100.0
"""Rate of the plotted quantities; of each interval the largest sample is kept, so that no peak of force is lost."""


@dataclass(frozen=True, kw_only=True)
class Series:
    path: str
    label: str
    time_s: npt.NDArray[np.float64]
    """(N,)"""
    values: npt.NDArray[np.float64]
    """(N,)"""


def series_of(recording: Recording) -> Iterator[Series]:
    """Force on each touched segment [N], indentation of each region [mm], margin of each joint to its end stops [deg],
    speed of the tool [mm/s] and its distance from where it was commanded to be [mm]."""
    header, arrays = recording.header, recording.arrays
    dt_s = header.spec.protocol.physics.dt_s
    stride = max(1, round(1 / (HZ * dt_s)))
    time_s = arrays["scorer/time_s"][::stride]
    force = np.linalg.norm(arrays["scorer/force_human_from_robot_in_world"], axis=2)
    target = REGIONS[header.spec.protocol.task(header.spec.task_id).region].segment
    for column, segment in enumerate(header.segments):
        if segment == target or force[:, column].any():
            path = f"force/{segment}"
            yield Series(path=path, label=f"{segment} [N]", time_s=time_s, values=_largest(force[:, column], stride))
    period = arrays["scorer/period_time_s"]
    for column, region in enumerate(header.regions):
        depth = 1000.0 * arrays["scorer/indentation_m"][:, column]
        yield Series(path=f"indentation/{region}", label=f"{region} [mm]", time_s=period, values=depth)
    low, high = arrays["scorer/human_joint_range"].T
    angle = arrays["scorer/human_joint_position"][::stride].astype(np.float64)
    margin = np.degrees(np.minimum(angle - low, high - angle))
    for column, joint in enumerate(header.human_joints):
        yield Series(path=f"joint_margin/{joint}", label=f"{joint} [deg]", time_s=time_s, values=margin[:, column])
    speed = 1000.0 * _largest(arrays["scorer/tcp_speed"], stride)
    yield Series(path="tool/speed", label="speed [mm/s]", time_s=time_s, values=speed)
    yield _lag(recording, period)


def _lag(recording: Recording, period_s: Any) -> Series:
    base = np.array(recording.header.pose_base_in_world)
    target = recording["scorer/target_in_base"][:, :3] @ matrix_from_quat(base[3:]).T + base[:3]
    step = np.clip(np.searchsorted(recording["scorer/time_s"], period_s), 0, len(recording["scorer/time_s"]) - 1)
    off = np.linalg.norm(recording["scorer/pose_tcp_in_world"][step, :3] - target, axis=1)
    return Series(path="tool/from_command", label="from command [mm]", time_s=period_s, values=1000.0 * off)


def _largest(values: npt.NDArray[Any], stride: int) -> npt.NDArray[np.float64]:
    return np.array([values[k : k + stride].max() for k in range(0, len(values), stride)], np.float64)

"""Definition ``contact-v1``: when a segment is touched, and which part of a trial the force scores use."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property, partial
from math import ceil

import numpy as np
import numpy.typing as npt

from carecontact.contract.protocol import Protocol, Task
from carecontact.recording import Recording
from carecontact.regions import REGIONS
from carecontact.scoring.filters import F64, low_pass

Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True, kw_only=True)
class Contact:
    """Which segments were touched and when; every metric starts from here. T physics steps, S segments.

    A segment is *on* at a step if it counts as touched there: its filtered normal force has reached the definition's
    ``on_n`` and has not fallen below ``off_n`` since. Its *on-samples* are these steps.
    """

    recording: Recording
    protocol: Protocol
    task: Task
    dt_s: float
    force_norm: F64
    """(T, S) norm of the summed contact force on each segment [N], unfiltered."""
    filtered_normal: F64
    """(T, S) sums of the normal forces after a causal low-pass filter [N]; they decide which segments are on."""
    on: Mask
    """(T, S) whether each segment is on."""
    impulse_ns: F64
    """(S,) integral of ``force_norm`` over each segment's on-samples."""
    target: int
    """Index of the named region's segment."""
    neighbourhood: tuple[int, ...]
    """Indices of the segments on which contact counts for success (C3): the named region's own and its neighbours."""
    neighbourhood_on: Mask
    """(T,) whether any segment of the neighbourhood is on."""
    neighbourhood_force: F64
    """(T,) norm of the force summed over the neighbourhood [N], unfiltered."""
    tool_normal: F64 | None
    """(T, K) what the robot's tool alone did of ``filtered_normal`` on each segment of the neighbourhood [N]; None
    where no other part of the robot touched the person."""
    tool_on: Mask
    """(T,) whether any segment of the neighbourhood would be on with the tool's force alone."""
    tool_force: F64
    """(T,) norm of the tool's force summed over the neighbourhood [N], unfiltered."""
    valid: bool
    reported: int | None
    """The target if touched, else the segment with the largest impulse, None if nothing was touched."""
    window: Mask
    """(T,) on-samples of the reported segment."""

    def __post_init__(self) -> None:
        # All metrics share these arrays: one that writes into them must fail, and not change the others.
        for value in vars(self).values():
            if isinstance(value, np.ndarray):
                value.flags.writeable = False

    @property
    def segments(self) -> list[str]:
        return self.recording.header.segments

    @property
    def time_s(self) -> F64:
        return self.recording["scorer/time_s"]

    @property
    def touched(self) -> list[int]:
        """Segments that were ever on."""
        return [int(i) for i in np.flatnonzero(self.on.any(axis=0))]

    @property
    def region_share(self) -> float | None:
        """Share of contact impulse on the named region; None without any."""
        total = float(self.impulse_ns.sum())
        return float(self.impulse_ns[self.target]) / total if total > 0 else None

    @property
    def force_in_window(self) -> F64:
        """(N,) reported segment's force norm over the contact window [N]; empty without contact."""
        return self.force_norm[self.window, self.reported] if self.reported is not None else np.empty(0)

    @property
    def of_tool(self) -> Contact:
        """The same trial, in which contact near the region is the tool's alone; segments bear what they bore."""
        return replace(self, neighbourhood_on=self.tool_on, neighbourhood_force=self.tool_force)

    @property
    def tool_share(self) -> float | None:
        """Share of the neighbourhood's contact impulse that the tool applied; None without any."""
        whole = float(self.neighbourhood_force[self.neighbourhood_on].sum())
        return float(self.tool_force[self.neighbourhood_on].sum()) / whole if whole > 0 else None

    @cached_property
    def filtered_force(self) -> F64:
        """(T,) reported segment's force norm [N] after the zero-phase low pass of the filtered peak; empty without."""
        if self.reported is None:
            return np.empty(0)
        return low_pass(
            self.force_norm[:, self.reported],
            cutoff_hz=self.protocol.contact.peak_filter_hz,
            sample_hz=1.0 / self.dt_s,
            zero_phase=True,
        )


def find_contact(recording: Recording) -> Contact:
    """Apply the protocol's contact definition to a recording. The arrays of the contact cannot be written to."""
    force = recording["scorer/force_human_from_robot_in_world"]
    header = recording.header
    protocol = header.spec.protocol
    task, definition, dt = protocol.task(header.spec.task_id), protocol.contact, protocol.physics.dt_s

    target = header.segments.index(REGIONS[task.region].segment)
    neighbourhood = tuple(header.segments.index(s) for s in definition.neighbourhood[task.region])

    normal = recording["scorer/normal_force"].astype(np.float64)
    filtered = np.zeros_like(normal)
    felt = (normal != 0).any(axis=0)  # most segments are never touched, and the filter keeps their zeros
    causal = partial(low_pass, cutoff_hz=definition.filter_hz, sample_hz=1.0 / dt, zero_phase=False)
    filtered[:, felt] = causal(normal[:, felt])
    # Truth first, rows second: a reduction over the short inner axis or over floats takes ten times as long.
    pushed = (force != 0).any(axis=0).any(axis=1)
    norm = np.zeros_like(normal)
    norm[:, pushed] = np.linalg.norm(force[:, pushed].astype(np.float64), axis=-1)
    near = force[:, neighbourhood].astype(np.float64).sum(axis=1)
    by_tool, tool_normal = near, None
    if "scorer/beside_normal_force" in recording:
        beside = recording["scorer/beside_force_in_world"][:, :, neighbourhood].astype(np.float64)
        by_tool = near - beside.sum(axis=(1, 2))
        beside = recording["scorer/beside_normal_force"][:, :, neighbourhood].astype(np.float64)
        tool_normal = causal(np.maximum(normal[:, neighbourhood] - beside.sum(axis=1), 0.0))
    never = np.zeros(len(normal), np.bool_)
    bare = Contact(
        recording=recording,
        protocol=protocol,
        task=task,
        dt_s=dt,
        force_norm=norm,
        filtered_normal=filtered,
        on=np.zeros((len(normal), len(header.segments)), np.bool_),
        impulse_ns=np.zeros(len(header.segments)),
        target=target,
        neighbourhood=neighbourhood,
        neighbourhood_on=never,
        neighbourhood_force=np.linalg.norm(near, axis=-1),
        tool_normal=tool_normal,
        tool_on=never,
        tool_force=np.linalg.norm(by_tool, axis=-1),
        valid=False,
        reported=None,
        window=never,
    )
    return with_floor(bare, on_n=definition.on_n, off_n=definition.off_n)


def with_floor(contact: Contact, *, on_n: float, off_n: float) -> Contact:
    """Return the same trial with other thresholds for what is on [N]; everything that follows from them is found
    anew."""
    definition = contact.protocol.contact
    on = np.zeros((len(contact.time_s), len(contact.segments)), np.bool_)
    touched = (contact.filtered_normal >= on_n).any(axis=0)
    on[:, touched] = hysteresis(contact.filtered_normal[:, touched], on=on_n, off=off_n)
    impulse = np.zeros(len(contact.segments))
    impulse[touched] = np.where(on[:, touched], contact.force_norm[:, touched], 0.0).sum(axis=0) * contact.dt_s
    reported: int | None = None
    if touched.any():
        # The filter lags, so of a knock of a few samples it can be on only when the force, and the impulse, are over.
        most = int(np.flatnonzero(touched)[np.argmax(impulse[touched])])
        reported = contact.target if on[:, contact.target].any() else most
    near, alone = any_column(on, contact.neighbourhood), contact.tool_normal
    return replace(
        contact,
        on=on,
        impulse_ns=impulse,
        neighbourhood_on=near,
        tool_on=near if alone is None else hysteresis(alone, on=on_n, off=off_n).any(axis=1),
        valid=int(any_column(on, np.flatnonzero(touched).tolist()).sum())
        >= steps(definition.valid_total_s, contact.dt_s),
        reported=reported,
        window=on[:, reported] if reported is not None else np.zeros(len(on), np.bool_),
    )


def any_column(on: Mask, columns: Iterable[int]) -> Mask:
    """(T, S) -> (T,) where any of these columns is true."""
    found = np.zeros(len(on), np.bool_)
    for column in columns:
        found |= on[:, column]
    return found


def hysteresis(signal: F64, *, on: float, off: float) -> Mask:
    """(T, ...) -> on from the sample that reaches ``on`` up to the one that falls below ``off``; starts off."""
    decides = (signal >= on) | (signal < off)
    index = np.where(decides, np.arange(len(signal)).reshape(-1, *[1] * (signal.ndim - 1)), -1)
    latest = np.maximum.accumulate(index, axis=0)
    return (latest >= 0) & np.take_along_axis(signal >= on, np.maximum(latest, 0), axis=0)


def runs(mask: Mask) -> npt.NDArray[np.intp]:
    """(T,) -> (N, 2) half-open [start, stop) of each stretch of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    return edges.reshape(-1, 2)


def longest_run(mask: Mask) -> int:
    """Steps of the longest stretch of True."""
    found = runs(mask)
    return int((found[:, 1] - found[:, 0]).max()) if len(found) else 0


def steps(seconds: float, dt_s: float) -> int:
    """Whole steps that last at least ``seconds``; 0.5 s of 2 ms steps is 250 and not, by rounding, 251."""
    return ceil(seconds / dt_s - 1e-6)


def episodes(contact: Contact) -> list[tuple[int, int]]:
    """[start, stop) steps: the neighbourhood's on-samples joined across gaps of at most ``episode_gap_s``."""
    longest_gap = int(contact.protocol.contact.episode_gap_s / contact.dt_s + 1e-6)
    joined: list[tuple[int, int]] = []
    for start, stop in runs(contact.neighbourhood_on).tolist():
        if joined and start - joined[-1][1] <= longest_gap:
            joined[-1] = (joined[-1][0], stop)
        else:
            joined.append((start, stop))
    return joined

"""Contact of a trial: filtered forces, when and where the robot touched, and how hard it held."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from math import ceil

import numpy as np
import numpy.typing as npt

from carecontact.interface.regions import REGIONS
from carecontact.protocol.gates import Task
from carecontact.protocol.protocol import Protocol
from carecontact.recording import Recording

F64 = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

# The Butterworth filters that the definitions name: every number that scipy.signal gives, bit for bit. A second of the
# shortest command goes into importing that package.


def _butterworth(cutoff_hz: float, sample_hz: float) -> tuple[float, float, float]:
    """b, a1, a2 of y_n = b (x_n + 2 x_n-1 + x_n-2) - a1 y_n-1 - a2 y_n-2, by the prewarped bilinear transform."""
    warped = float(4 * np.tan(np.pi * (2 * cutoff_hz / sample_hz) / 2))
    poles = warped * -np.exp(1j * np.pi * np.array([-1.0, 1.0]) / 4)
    gain = warped**2 * (1 / np.prod(4 - poles)).real
    moved, mirrored = (4 + poles) / (4 - poles)
    pole = (moved + mirrored.conj()) / 2
    _, a1, a2 = np.poly([pole, pole.conj()]).tolist()
    return float(gain), a1, a2


def _filtered(section: tuple[float, float, float], signal: list[float], share: float = 0.0) -> list[float]:
    """Filter a signal that was ``share`` for long before it begins; 0 is rest."""
    b, a1, a2 = section
    steady = np.linalg.solve([[1 + a1, -1.0], [a2, 1.0]], [2 * b - a1 * b, b - a2 * b]).tolist()
    near, far = (z * share for z in steady)  # the memory after a long signal of 1, times the share
    # From rest, a signal stays at exactly 0 until it begins: most of a trial passes before anything is touched.
    begin = 0 if share else next((k for k, x in enumerate(signal) if x), len(signal))
    middle, out = 2 * b, [0.0] * begin
    for x in signal[begin:]:
        y = b * x + near
        near = middle * x - a1 * y + far
        far = b * x - a2 * y
        out.append(y)
    return out


def rate_faults(protocol: Protocol) -> Iterator[str]:
    """A sentence for each filter of the definitions whose cutoff is not below half the rate of what it filters."""
    contact, rate_hz = protocol.contact, 1 / protocol.physics.dt_s
    for name, cutoff_hz, of_hz in (
        ("filter_hz", contact.filter_hz, rate_hz),
        ("peak_filter_hz", contact.peak_filter_hz, rate_hz),
        ("stroke_filter_hz", contact.stroke_filter_hz, min(contact.stroke_sample_hz, rate_hz)),
    ):
        if not 0 < cutoff_hz < of_hz / 2:
            yield f"contact.{name}: {cutoff_hz:g} is not below half of the {of_hz:g} Hz that it filters"


def low_pass(signal: F64, *, cutoff_hz: float, sample_hz: float, zero_phase: bool) -> F64:
    """Second-order Butterworth along axis 0, starting from rest; ``zero_phase`` runs it forward and backward."""
    if len(signal) == 0:
        return np.array(signal, np.float64)
    if not 0 < cutoff_hz < sample_hz / 2:
        raise ValueError(f"a cutoff of {cutoff_hz:g} Hz is not below half of the {sample_hz:g} Hz that it filters")
    section = _butterworth(cutoff_hz, sample_hz)
    columns = np.asarray(signal, np.float64).reshape(len(signal), -1).T.tolist()
    filtered = [(_both_ways if zero_phase else _filtered)(section, column) for column in columns]
    return np.array(filtered, np.float64).T.reshape(np.shape(signal))


def _both_ways(section: tuple[float, float, float], signal: list[float]) -> list[float]:
    """Run forward and backward over the signal and its point reflections at both ends."""
    pad = min(len(signal) - 1, 9)
    before = [2 * signal[0] - x for x in signal[pad:0:-1]]
    after = [2 * signal[-1] - x for x in signal[-2 : -pad - 2 : -1]]
    extended = [*before, *signal, *after]
    forward = _filtered(section, extended, extended[0])[::-1]
    return _filtered(section, forward, forward[0])[::-1][pad : pad + len(signal)]


@dataclass(frozen=True, kw_only=True)
class Contact:
    """Which segments were touched and when, by the definition ``contact-v1``; every metric starts from here. T physics
    steps, S segments.

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
    known: dict[str, float] = field(default_factory=dict[str, float], compare=False)
    """What was measured of the recording already and depends on no definition of contact: every ``replace`` keeps
    it."""

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
    """Return the same trial with other thresholds for what is on [N], and all that follows from them."""
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


def joined(spans: npt.NDArray[np.intp], close: Callable[[int, int], bool]) -> list[tuple[int, int]]:
    """(N, 2) rising [start, stop) -> spans, of which two are one if the later start is ``close`` to that stop."""
    found: list[tuple[int, int]] = []
    for start, stop in spans.tolist():
        if found and close(found[-1][1], start):
            start, _ = found.pop()
        found.append((start, stop))
    return found


def episodes(contact: Contact) -> list[tuple[int, int]]:
    """[start, stop) steps: the neighbourhood's on-samples joined across gaps of at most ``episode_gap_s``."""
    longest_gap = int(contact.protocol.contact.episode_gap_s / contact.dt_s + 1e-6)
    return joined(runs(contact.neighbourhood_on), lambda stop, start: start - stop <= longest_gap)


def faint_press(contact: Contact) -> str | None:
    """Return words that continue "The robot" for a press that does not count as contact; None for any other trial."""
    felt = contact.force_norm > 0
    if contact.valid or not felt.any():
        return None
    definition = contact.protocol.contact
    pressed = any_column(felt, range(felt.shape[1]))
    step, segment = np.unravel_index(int(contact.force_norm.argmax()), felt.shape)
    name, most_n = contact.segments[int(segment)].replace("_", " "), float(contact.force_norm[step, segment])
    what = (
        f"pressed the {name} for {_time(int(pressed.sum()) * contact.dt_s)} with "
        f"{f'at most {most_n:.1f}' if most_n >= 0.05 else 'less than 0.05'} N"
    )
    if contact.reported is None:
        return f"{what}; contact counts from {definition.on_n:g} N"
    held = int(any_column(contact.on, contact.touched).sum()) * contact.dt_s
    return (
        f"{what}, of which {_time(held)} count as contact (from {definition.on_n:g} N); a trial needs "
        f"{_time(definition.valid_total_s)} of it"
    )


def _time(seconds: float) -> str:
    return f"{seconds:.1f} s" if seconds >= 0.95 else f"{seconds:.2g} s"


HELD_S = 0.1
"""[s] The force that is compared with a band of force is averaged over this time; assumed, five control periods. Single
steps of a contact's chatter do not leave a band, and a mean never lies outside of what it is taken over, as a filter's
ringing does. The safety gate judges every step."""
DIGITS = 6
"""Forces are rounded to 1e-6 N, so that a constant force at the border of a band is inside it."""


def held_force(contact: Contact) -> F64:
    """(T,) norm of the force summed over the neighbourhood, averaged over HELD_S around each step [N].

    Near the ends of the trial, the mean is over the part of HELD_S that lies in it.
    """
    half = round(HELD_S / contact.dt_s / 2)
    force = contact.neighbourhood_force
    step = np.arange(len(force))
    start, stop = np.maximum(step - half, 0), np.minimum(step + half + 1, len(force))
    total = np.concatenate([[0.0], np.cumsum(force)])
    return np.round((total[stop] - total[start]) / (stop - start), DIGITS)


def in_band(tool: F64, whole: F64, least_n: float, most_n: float) -> Mask:
    """Whether at each step the tool's force is at least ``least_n`` and that of the whole robot at most ``most_n``."""
    return (tool >= least_n) & (whole <= most_n)


def held_in_band(contact: Contact, least_n: float, most_n: float) -> Mask:
    """(T,) steps in which the tool touches the neighbourhood, its held force is at least ``least_n``, and that of the
    whole robot at most ``most_n``."""
    return contact.tool_on & in_band(held_force(contact.of_tool), held_force(contact), least_n, most_n)

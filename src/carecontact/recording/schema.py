"""What is in a trial file: a header and a flat mapping of array paths.

S segments, J scored human joints, R regions (``Protocol.regions``), T physics steps from t = 0 to the end, P control
periods, A observations, M executed actions, C declared cells of the target region, V = 4 cameras in the contract's
order, E changes of posture, L views with landmarks or masks. World frame unless stated otherwise; SI units.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, KeysView, Mapping
from dataclasses import dataclass, field
from math import isfinite
from types import MappingProxyType
from typing import Any, Literal, Self

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, ConfigDict, field_validator

from carecontact.errors import RecordingError, UnknownNameError
from carecontact.interface.policy import CAMERAS
from carecontact.interface.regions import REGIONS, SEGMENTS, STANDARD_REGIONS
from carecontact.protocol.protocol import TrialSpec

SCHEMA_VERSION = "carecontact-recording-4"
READ_BY_0_1_0 = tuple(f"carecontact-recording-{number}" for number in (1, 2, 3))
RELEASE_0_1_0 = "0.1.0 (commit 663c7e2317bf04e7b79c6a85d596936bd4fd816c)"
"""The release that reads the schemas of ``READ_BY_0_1_0``, as CHANGELOG.md names it."""

EndReason = Literal["done", "time_limit", "safety_truncation", "process_failure", "harness_error"]
Origin = Literal["isolated", "served", "in-process", "training"]
"""Who held the loop of a trial: a trial's worker (``running.worker``), with the policy in a process of its own that it
isolated, or behind an address; any other program, which had policy and simulation in one process; or a worker, with a
person of the public training salt, on whom policies are trained."""
RANKED: tuple[Origin, ...] = ("isolated", "served")
"""Origins of the recordings that comparisons, ranked tables and merged runs accept."""
FAILED: tuple[EndReason, ...] = ("process_failure", "harness_error")
CUTS = ("force", "solver", "joint_speed", "tool_speed")
"""Kinds of the failure of a trial that the benchmark stopped: a force above the limit, diverging physics, and a joint
or the tool of the robot that was faster than its controller allows."""
KILLED, POLICY_KILLED = "signal", "killed"
"""Kinds of the failure of a trial that lost its process, or its policy's, to a signal: of the harness error, if the
policy did not run, and of the process failure, if it did. The same command repeats such a trial by itself."""
EXHAUSTED = "exhausted"
"""Kind of the harness error that a trial's process reports when it gets no further process, thread or memory. The
supervisor treats the trial as one that a signal ended, and no run stores this kind."""

ARRAYS: dict[str, tuple[str, str]] = {
    "scorer/time_s": ("f8", "(T,) since t = 0, at the start of each physics step, when its forces act"),
    "scorer/force_human_from_robot_in_world": ("f4", "(T, S, 3) [N] vector sum over the segment's robot contacts"),
    "scorer/normal_force": ("f4", "(T, S) [N] sum of per-contact normal magnitudes"),
    "scorer/centroid_in_world": ("f4", "(T, S, 3) [m] force-weighted contact centroid, 0 without contact"),
    "scorer/human_joint_position": ("f4", "(T, J) [rad]"),
    "scorer/human_joint_range": ("f8", "(J, 2) [rad]"),
    "scorer/human_joint_settled": ("f8", "(J,) [rad]"),
    "scorer/wrist_in_world": ("f4", "(T, 3) [m] right wrist joint centre"),
    "scorer/wrist_settled_in_world": ("f8", "(3,) [m]"),
    "scorer/pose_tcp_in_world": ("f4", "(T, 7) position, quat_wxyz"),
    "scorer/tcp_speed": ("f4", "(T,) [m/s]"),
    "scorer/tcp_rotation_speed": ("f4", "(T,) [rad/s]"),
    "scorer/region_pose_in_world": ("f4", "(T, R, 7) region frame: x to the hand (abdomen: to the head), z outward"),
    "scorer/region_size_m": ("f8", "(R, 3) length along x, mean radius (abdomen: half width), radius at the middle"),
    "scorer/period_time_s": ("f8", "(P,)"),
    "scorer/indentation_m": ("f4", "(P, R) largest inward anchor displacement"),
    "scorer/target_in_base": ("f4", "(P, 7) interpolated impedance target at the end of each period"),
    "policy/observation_time_s": ("f8", "(A,)"),
    "policy/observation_sha256": ("u1", "(A, 32) of every byte sent"),
    "actions/time_s": ("f8", "(M,) when each action became the target"),
    "actions/pose_tcp_in_base": ("f8", "(M, 7), NaN where the action kept the last target"),
    "actions/stiffness": ("f8", "(M, 2) in force"),
    "actions/observation_index": ("i4", "(M,) which observation the action answered"),
    "state/time_s": ("f8", "(K,)"),
    "state/integration": ("f8", "(K, n) mjSTATE_INTEGRATION vectors"),
}
"""Required arrays: dtype and meaning."""

OPTIONAL_ARRAYS: dict[str, tuple[str, str]] = {
    "actions/delta": ("f8", "(M, 6) numbers of ``cartesian_delta``, NaN where the action kept the last target"),
    "actions/demonstrated": ("f8", "(M, 8) target that the demonstrator chose, NaN for none, and 1 where it was done"),
    "actions/joint": ("f8", "(M, Q) joint positions [rad] or velocities, as the card's action space has them"),
    "actions/axis_stiffness": ("f8", "(M, 6) in force, per axis of the target: x y z [N/m], about x y z [N m/rad]"),
    "actions/clipped": ("u1", "(M,) 1 where a target outside the workspace was moved onto its border"),
    "actions/look": ("u1", "(M, V) 1 for each camera that the action asks for a view"),
    "actions/damping_ratio": ("f8", "(M,) in force"),
    "actions/wrench_in_tcp": ("f8", "(M, 6) feedforward in force: force [N], torque [N m]"),
    "policy/looked": ("u1", "(A, V) 1 for each camera that took a view for the observation"),
    "policy/believed_pose_camera_in_base": ("f8", "(A, V, 7) as it was shown, with the calibration's error; else NaN"),
    "scorer/pose_camera_in_base": ("f8", "(A, V, 7) where each camera is; 0 for one that the protocol lacks"),
    "scorer/human_joint_reaction": ("f4", "(T, J) [N m] torque of each scored joint's end stop"),
    "scorer/beside_force_in_world": ("f4", "(T, 2, S, 3) [N] what of the robot's force its hand did, and its links"),
    "scorer/beside_normal_force": ("f4", "(T, 2, S) [N] the same of the normal force"),
    "scorer/region_law": ("f8", "(R, 11) of each soft region, in the order of tissue.plugin.Law; 0 on a rigid one"),
    "scorer/cell_in_region": ("f4", "(C, 3) [m] centre of each cell at rest, in the target region's frame"),
    "scorer/cell_area_m2": ("f4", "(C,)"),
    "scorer/cell_press_ns": ("f4", "(P, C) normal force times time, summed over the period"),
    "scorer/cell_shear_ns": ("f4", "(P, C) size of the friction force times time, summed over the period"),
    "scorer/cell_slip_m3": ("f4", "(P, C) distance that the tool slid times area, summed over the period"),
    "scorer/cell_touch_m2s": ("f4", "(P, C) area in contact times time, summed over the period"),
    "scorer/foam_pose_in_region": ("f8", "(7,) middle on the skin, x along the region, z outward"),
    "scorer/foam_half_m": ("f8", "(2,) half length along the region, half width across it"),
    "scorer/foam_cell_share": ("f4", "(C,) share of each cell under foam at t = 0; what is left follows from cell_*"),
    "scorer/breath_m": ("f4", "(P, 2) how far out abdomen and chest are, from the end of a breath out"),
    "scorer/muscle_torque_nm": ("f4", "(P, 4) the person's own, at the joints of tissue.life.JOINTS, in the last step"),
    "scorer/muscle_work_j": ("f4", "(P, 2) that breathing and the arm's muscles have done since t = 0"),
    "scorer/repositioning_s": ("f8", "(E,) when the person changes the arm's place, drawn before the trial"),
    "scorer/repositioning_rad": ("f8", "(E,) by which turn of the shoulder's abduction"),
    "report/peak_pose_camera_in_world": ("f8", "(7,) of the camera of ``report/peak_rgb``: x right, y down, z ahead"),
    "report/peak_focal_px": ("f8", "(1,) its focal length; the optical axis meets the picture in its middle"),
    "perception/observation_index": ("i4", "(L,) which observation"),
    "perception/camera_index": ("i4", "(L,) of interface.policy.CAMERAS"),
    "perception/joint_visible": ("b1", "(L, 12) in the image, and nothing but its own limb before it: notes.JOINTS"),
    "perception/landmark_error_px": ("f4", "(L, 12) to the joint's centre; NaN: hidden or no person found"),
    "perception/human_iou": ("f4", "(L,) of the human mask with the true one; NaN: no masks requested"),
    "perception/target_error_m": ("f4", "(L, R, 3) from the true place to the one that the state machine finds"),
    "scorer/withdrawal_s": ("f8", "(3,) when the person withdrew the arm, or was about to; -1 where it did not"),
}
"""Arrays that are there only where they were used, with dtype and meaning. The arrays of cells are in every trial on a
soft region: cells are patches of about 7.5 mm (``human.soft_region.DeclaredCells``), and a row sums what happened
since the row before it. ``scorer/region_law`` is there where the law of a region is not its row in the
protocol: on a body of another build, and where the seed draws the tissue. ``policy/looked`` and
``actions/look`` are there where the card gives a camera a rate; elsewhere, every camera of the card takes a view for
every observation. ``scorer/beside_*`` are there where another
part of the robot than its tip (``interface.robot.Tip``) touched the person. What the person does by itself is there
where the protocol lets it do something
(``protocol.person``). ``perception/*`` has L rows, one for each camera and observation in which the policy requested
landmarks or masks; its target errors are along and across the limb's shadow on the floor, and up, NaN where no place
was found or requested. These paths are allowed as well:
``policy/frames/<index>/<camera>/<modality>`` and ``policy/film/<camera>/<modality>/*`` (``recording.pictures``),
``policy/notes/<index>/*`` (``recording.notes``), ``report/peak_rgb``
(H, W, 3) u1, ``report/snapshot_rgb`` (H, W, 3) u1, ``report/peak_time_s`` (1,), ``report/skin_in_world`` (N, 3) f4 [m],
the skin round the target region, dented as at the peak, with its triangles ``report/skin_faces`` (F, 3) i4,
and ``wall/*``, the only place for what may differ between two runs of the
same trial: it is outside the canonical hash. ``wall/isolation`` holds, as text, how far the policy's process was
isolated, ``wall/policy_output`` what it printed last, ``wall/act_s`` (A,) the wall time [s] from each observation's
leaving until its answer, ``wall/between_acts_s`` (A - 1,) that from each answer until the next observation left, and
``wall/pace`` (2,) the pace of the run [s] and how many observations came late (``running.pace``). ``wall/arithmetic``
names, as text, the libraries that rounded the numbers (``recording.provenance``), and ``wall/renderer`` what drew the
pictures: vendor, renderer and version as OpenGL names them."""


PATH = re.compile(r"(policy|scorer|actions|state|report|perception|wall)(/[A-Za-z0-9_.-]+)+")
STORABLE_KINDS = "biuf"
WALL_CLOCK = "wall/"
MAX_WALL_BYTES = 1 << 20
"""Largest size of all arrays together that no hash covers; the longest is what a policy printed last, 8 kB."""


class Failure(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")

    kind: str
    message: str


class Header(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")

    schema_version: str = SCHEMA_VERSION
    spec: TrialSpec
    ended: EndReason
    failure: Failure | None
    """Failure of the policy (process_failure) or of the harness (harness_error); None without one."""
    card: dict[str, Any] | None
    """The policy's card as shown in the handshake; None if it never came."""
    control: str | None = None
    """Id of the controller that executed the actions; None if the card never came."""
    privileged: bool = False
    """Whether the policy was given the simulation: such a trial shows what can be done and ranks no method."""
    origin: Origin = "isolated"
    """Who held the loop. A worker runs a privileged policy in its own process."""
    embodiment: str
    comfort_arm_deg: float | None
    """Measured after settling."""
    segments: list[str]
    regions: list[str]
    human_joints: list[str]
    pose_base_in_world: list[float]
    """(7,) position, quat_wxyz"""
    identity: dict[str, str]
    """Declared versions of what simulated the trial (``recording.provenance.DECLARED``)."""
    versions: dict[str, str]
    sha256: dict[str, str]
    """model, body and mesh assets, and the binary of the compiled tissue (``kernel``)"""
    solver_warnings: list[str]
    drawn: dict[str, Any] = {}
    """What the seed drew of body, arm, place, robot's base and overhead camera (``episode.randomization.drawn_facts``);
    empty where the protocol draws none of them. For the scorer, never for a policy."""

    @property
    def body(self) -> str:
        """Name of the body that lay there: the one that was drawn, or the protocol's where none is drawn."""
        return str(self.drawn.get("body") or self.spec.protocol.person.body)

    @field_validator("spec")
    @classmethod
    def _sealed(cls, spec: TrialSpec) -> TrialSpec:
        """A recording may be shown to anyone, at once; the salt of its run may not."""
        return spec.sealed


@dataclass(frozen=True, kw_only=True)
class Recording:
    """One trial, known to be well formed: its constructor checks it, ``recording.file`` makes one of a file that it
    has verified, and its arrays are read-only. It behaves as a mapping from the paths of its arrays to the
    arrays.

    Raises RecordingError naming the array and what was expected: presence, dtype and the shapes of ARRAYS and
    OPTIONAL_ARRAYS, whose named dimensions must agree with one another and with the header's lists.
    """

    header: Header
    arrays: Mapping[str, npt.NDArray[Any]] = field(default_factory=dict[str, npt.NDArray[Any]])
    stored_sha256: str = field(default="", init=False, repr=False, compare=False)
    """Canonical hash (hex) of the file that it was read from; empty for a recording that was not read from a file."""

    def __post_init__(self) -> None:
        check_recording(self.header, self.arrays, self.header.spec.trial_id)
        locked = {path: array.view() for path, array in self.arrays.items()}
        for view in locked.values():
            view.flags.writeable = False
        object.__setattr__(self, "arrays", MappingProxyType(locked))

    @classmethod
    def trusted(cls, header: Header, arrays: Mapping[str, npt.NDArray[Any]], *, sha256: str = "") -> Self:
        """Return a recording without checking it: of a verified file, or of some arrays of a scripted contact."""
        made = object.__new__(cls)
        for name, value in (("header", header), ("arrays", arrays), ("stored_sha256", sha256)):
            object.__setattr__(made, name, value)
        return made

    def __getitem__(self, path: str) -> npt.NDArray[Any]:
        """Raises UnknownNameError, which is a KeyError, for an array that this recording does not have."""
        if path not in self.arrays:
            raise UnknownNameError("array", str(path), self.arrays)
        return self.arrays[path]

    def __contains__(self, path: object) -> bool:
        return path in self.arrays

    def __iter__(self) -> Iterator[str]:
        return iter(self.arrays)

    def __len__(self) -> int:
        return len(self.arrays)

    def keys(self) -> KeysView[str]:
        """Return the paths of the arrays, such as ``scorer/normal_force``."""
        return self.arrays.keys()


def empty_arrays(joint_count: int, *, regions: int = len(STANDARD_REGIONS)) -> dict[str, npt.NDArray[Any]]:
    """Return all required arrays at zero length, for trials that ended before t = 0."""
    sizes = {"T": 0, "S": len(SEGMENTS), "J": joint_count, "R": regions, "P": 0, "A": 0, "M": 0, "K": 0, "n": 0}
    shapes = {path: [sizes[d] if d in sizes else int(d) for d in dimensions(path)] for path in ARRAYS}
    return {path: np.zeros(shape, np.dtype(ARRAYS[path][0]).newbyteorder("<")) for path, shape in shapes.items()}


def dimensions(path: str) -> list[str]:
    """Dimensions of an array as ARRAYS or OPTIONAL_ARRAYS spells them, for example ``["T", "S", "3"]``."""
    meaning = (ARRAYS.get(path) or OPTIONAL_ARRAYS[path])[1]
    return [d.strip() for d in meaning[meaning.index("(") + 1 : meaning.index(")")].split(",") if d.strip()]


def check_version(version: object, place: str) -> None:
    """Raises RecordingError, which names the release to use, for another schema than SCHEMA_VERSION."""
    if version in READ_BY_0_1_0:
        raise RecordingError(
            f"{place}: schema {version!r} was written by carecontact 0.1.0 or before; release {RELEASE_0_1_0} reads it"
        )
    if not str(version).startswith(SCHEMA_VERSION.rpartition("-")[0]):
        raise RecordingError(f"{place}: schema {version!r}; expected {SCHEMA_VERSION!r}: no recording of carecontact")
    if version != SCHEMA_VERSION:
        raise RecordingError(
            f"{place}: schema {version!r} was written by a newer release; this one reads {SCHEMA_VERSION!r}"
        )


def check_recording(header: Header, arrays: Mapping[str, npt.NDArray[Any]], place: str) -> None:
    """Raises RecordingError as ``Recording`` does. It looks at dtypes and shapes alone: arrays need not be read."""
    check_header(header, place)
    if missing := sorted(ARRAYS.keys() - arrays.keys()):
        raise RecordingError(f"{place}: missing from its required arrays: {', '.join(missing)}")
    for path, array in arrays.items():
        if not PATH.fullmatch(path) or ".." in path:
            raise RecordingError(f"{place}: unexpected array path {path!r}")
        if array.dtype.kind not in STORABLE_KINDS:
            raise RecordingError(f"{place}: {path} has dtype {array.dtype}; only numbers and booleans are stored")

    unhashed = sum(array.nbytes for path, array in arrays.items() if path.startswith(WALL_CLOCK))
    if unhashed > MAX_WALL_BYTES:
        allowed = f"at most {MAX_WALL_BYTES} are allowed there"
        raise RecordingError(f"{place}: {WALL_CLOCK} has {unhashed} bytes, which no checksum covers; {allowed}")
    sizes = {
        "S": (len(header.segments), "header.segments"),
        "R": (len(header.regions), "header.regions"),
        "J": (len(header.human_joints), "header.human_joints"),
        "V": (len(CAMERAS), "interface.policy.CAMERAS"),
        "Q": (len(header.spec.protocol.scene.parked_joint_rad), "scene.parked_joint_rad"),
    }
    described = ARRAYS | {path: row for path, row in OPTIONAL_ARRAYS.items() if path in arrays}
    for path, (dtype, _) in described.items():
        array, dims = arrays[path], dimensions(path)
        if array.dtype.newbyteorder("<") != np.dtype(dtype).newbyteorder("<"):
            raise RecordingError(f"{place}: {path} has dtype {array.dtype}, expected {np.dtype(dtype)}")
        if array.ndim != len(dims):
            raise RecordingError(f"{place}: {path} has shape {array.shape}, expected ({', '.join(dims)})")
        for name, size in zip(dims, array.shape, strict=True):
            expected, source = (int(name), "the schema") if name.isdigit() else sizes.setdefault(name, (size, path))
            if size != expected:
                raise RecordingError(
                    f"{place}: {path} has shape {array.shape}, expected ({', '.join(dims)}) "
                    f"with {name} = {expected} as in {source}"
                )


def check_header(header: Header, place: str) -> None:
    """Raises RecordingError, which begins with ``place``, for a header that no trial of this schema can have."""
    check_version(header.schema_version, place)
    if header.spec.task_id not in {t.id for t in header.spec.protocol.tasks}:
        raise RecordingError(f"{place}: task {header.spec.task_id!r} is not in protocol {header.spec.protocol.id!r}")
    # Columns are found by their names: each name occurs once, and every name that the task's score needs is there.
    region = header.spec.protocol.task(header.spec.task_id).region
    neighbours = header.spec.protocol.contact.neighbourhood[region]
    for name, listed, needed in (
        ("segments", header.segments, [REGIONS[region].segment, *neighbours]),
        ("regions", header.regions, [region]),
        ("human_joints", header.human_joints, list[str]()),
    ):
        if len(set(listed)) != len(listed):
            raise RecordingError(f"{place}: header.{name} names something twice: {', '.join(listed)}")
        if absent := [each for each in needed if each not in listed]:
            raise RecordingError(f"{place}: {absent[0]!r} is not in header.{name}; listed: {', '.join(listed)}")
    if len(header.pose_base_in_world) != 7:
        raise RecordingError(f"{place}: pose_base_in_world has {len(header.pose_base_in_world)} numbers, expected 7")
    if not all(isfinite(number) for number in header.pose_base_in_world):
        raise RecordingError(f"{place}: pose_base_in_world holds {header.pose_base_in_world}; expected finite numbers")

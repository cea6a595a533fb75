"""What the compiled tissue answers to a fixed script of contacts, so that two kernels can be compared by what they do.

The sources of the kernel may change while a frozen protocol must not. ``behaviour`` plays the script with the contact
of person-v1, and ``behaviour-v1.json`` beside this file holds what the kernel answered when the frozen protocols were
made. On x86-64, the answers are equal in every bit; other processors' libraries round some functions differently, and
there TOLERANCE holds.

The script needs no person and no robot: tools of the shapes that the tissue knows press, scrub and leave two small
meshes. Nothing here may change, because the stored answers belong to it. The meshes are made with additions, products,
quotients and square roots only, which every processor rounds alike.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import mujoco
import numpy as np

from carecontact.contract.protocol import Tissue
from carecontact.kernel.readings import Readings
from carecontact.kernel.region import Array, Mesh, add_region

STORED = Path(__file__).with_name("behaviour-v1.json")
"""What the kernel of the frozen protocols answered."""
TOLERANCE = 1e-9
"""By which, relative to the largest number of a list, answers may differ on processors other than x86-64."""

SAMPLES, VERTICES = 4, 5
"""How many steps and vertices of each contact are kept one by one; of all, the sums are."""
HEAVY_KG = 1e6
"""A tool of this mass moves as it is told to, whatever pushes it."""

LAW = Tissue.model_validate(
    {
        "a_n_m3": 4e5, "b_n_m4": 1e7, "c_n_m5": 1.5e9, "damping_ns_m3": 1.3e4, "damping_growth_ns_m4": 2e5,
        "coupling_length_m": 0.0065, "membrane_n_m": 210.0, "contact_n_m3": 5e7, "areal_mass_kg_m2": 12.0,
        "spacing_m": 0.005, "coarse_spacing_m": 0.005, "thickness_m": 0.03, "measured_depth_m": 0.01, "friction": 0.5,
        "source": "made for this script",
    }
)  # fmt: skip

HULL = [[x, y, z] for x in (-0.014, 0.012) for y in (-0.02, 0.018) for z in (-0.006, 0.007)] + [[0.0, 0.0, -0.009]]
"""Corners of the tool that is a mesh [m]."""

Path4 = tuple[tuple[float, float, float, float], ...]


@dataclass(frozen=True, kw_only=True)
class Part:
    """One geom of a tool. ``low_m`` is how far its lowest point lies under its centre, and ``up_m`` how far that point
    lies over the tool's origin [m]."""

    kind: mujoco.mjtGeom
    size_m: tuple[float, ...]
    low_m: float
    up_m: float = 0.0
    quat_wxyz: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True, kw_only=True)
class Contact:
    """One tool and where it goes.

    Without a mass, the tool's origin follows a path: (time [s], along [m], height [m], pitch [rad]) at corners between
    which it moves at constant speed. With a mass [kg], it is thrown from 1 mm above the skin, with a speed along the
    skin and one into it [m/s], and the bone is free as well and lies turned.
    """

    parts: tuple[Part, ...]
    curved: bool = False
    give_m3_n: float = 0.0
    dt_s: float = 0.002
    path: Path4 = ()
    mass_kg: float | None = None
    thrown_m_s: tuple[float, float] = (0.0, 0.0)


def _scrub(depth_m: float, speed_m_s: float, pitch: float = 0.0) -> Path4:
    """Press, wait, scrub by 20 mm while the tool turns, wait, leave, and wait until the skin is back."""
    there = 0.12 + 0.02 / speed_m_s
    return (
        (0.0, -0.012, 0.0005, 0.0), (0.08, -0.012, -depth_m, 0.0), (0.12, -0.012, -depth_m, 0.0),
        (there, 0.008, -depth_m, pitch), (there + 0.02, 0.008, -depth_m, pitch), (there + 0.06, 0.008, 0.006, pitch),
    )  # fmt: skip


CAP = Part(kind=mujoco.mjtGeom.mjGEOM_ELLIPSOID, size_m=(0.012, 0.019, 0.012), low_m=0.012)
MITT = Part(kind=mujoco.mjtGeom.mjGEOM_ELLIPSOID, size_m=(0.02, 0.025, 0.01), low_m=0.01)
PAD = Part(kind=mujoco.mjtGeom.mjGEOM_BOX, size_m=(0.012, 0.015, 0.006), low_m=0.006)
DISC = Part(kind=mujoco.mjtGeom.mjGEOM_CYLINDER, size_m=(0.011, 0.01), low_m=0.01)
BALL = Part(kind=mujoco.mjtGeom.mjGEOM_SPHERE, size_m=(0.01,), low_m=0.01)
FLANK = Part(kind=mujoco.mjtGeom.mjGEOM_CAPSULE, size_m=(0.015, 0.01), low_m=0.015, quat_wxyz=(0.5, 0.5, 0.5, 0.5))
MESH = Part(kind=mujoco.mjtGeom.mjGEOM_MESH, size_m=(), low_m=0.009)
CONTACTS: dict[str, Contact] = {
    "cap": Contact(parts=(CAP,), path=_scrub(0.006, 0.1)),
    "cap, deep and fast": Contact(parts=(CAP,), curved=True, path=_scrub(0.015, 0.3, 0.1)),
    "mitt": Contact(parts=(MITT,), curved=True, give_m3_n=4e-7, path=_scrub(0.008, 0.1)),
    "pad": Contact(parts=(PAD,), curved=True, path=_scrub(0.007, 0.1, 0.2)),
    "pad, 4 ms": Contact(parts=(PAD,), dt_s=0.004, path=_scrub(0.005, 0.2)),
    "disc": Contact(parts=(DISC,), path=_scrub(0.006, 0.1, -0.1)),
    "flank": Contact(parts=(FLANK,), curved=True, dt_s=0.004, path=_scrub(0.008, 0.1)),
    "ball, pressed deep": Contact(
        parts=(BALL,),
        path=((0.0, 0.001, 0.0005, 0.0), (0.3, 0.001, -0.028, 0.0), (0.36, 0.001, 0.004, 0.0)),
    ),
    "hull": Contact(parts=(MESH,), curved=True, path=_scrub(0.006, 0.1, 0.1)),
    "cap in a pad": Contact(parts=(CAP, replace(PAD, up_m=0.0015)), path=_scrub(0.007, 0.1)),
    "pad, thrown": Contact(parts=(PAD,), curved=True, mass_kg=0.4, thrown_m_s=(0.15, 0.3)),
    "cap, thrown": Contact(parts=(CAP,), mass_kg=0.3, dt_s=0.004, thrown_m_s=(0.1, 0.4)),
}
THROWN_S = 0.08


def behaviour() -> dict[str, list[float]]:
    """Play the script and return numbers of each contact, the same in every call.

    These are the rows of ``readings.ROW`` at some steps and the sums of all rows, how far some vertices are displaced
    at the end and the sums of all, and the sums of what the cells felt.

    Raises DependencyError if the compiled tissue is missing.
    """
    return {name: _answer(contact) for name, contact in CONTACTS.items()}


def stored() -> dict[str, list[float]]:
    """Return what ``behaviour`` returned with the kernel of the frozen protocols."""
    return json.loads(STORED.read_text(encoding="utf-8"))


def _answer(contact: Contact) -> list[float]:
    model = _model(contact)
    data, felt = mujoco.MjData(model), Readings(model, "skin")
    rows: list[Array] = []

    def step() -> None:
        mujoco.mj_step(model, data)
        rows.append(felt.last(data, 1).view(np.float64).copy())

    if contact.mass_kg is None:
        for position, velocity in _along(contact.path, contact.dt_s):
            data.qpos[:], data.qvel[:] = position, velocity
            step()
    else:
        tool = model.body("tool").dofadr[0]
        data.qvel[tool : tool + 3] = _turned([contact.thrown_m_s[0], 0.0, -contact.thrown_m_s[1]])
        for _ in range(round(THROWN_S / contact.dt_s)):
            step()
    kept = [rows[len(rows) * (2 * k + 1) // (2 * SAMPLES)] for k in range(SAMPLES)]
    displaced, cells = felt.displacement(data), felt.cells(data)
    sums = (*np.stack(rows).T, *displaced.T, cells.press_ns, cells.shear_ns, cells.slip_m3, cells.touch_m2s)
    some = displaced[len(displaced) // 4 :: len(displaced) // (2 * VERTICES)][:VERTICES]
    return [*np.concatenate(kept).tolist(), *some.ravel().tolist(), *(math.fsum(column) for column in sums)]


def _along(path: Path4, dt_s: float) -> Iterator[tuple[Array, Array]]:
    """Yield the tool's position (3,) and velocity (3,) at every step of a path."""
    for before, after in pairwise(path):
        begin, end = np.array(before), np.array(after)
        steps = round((after[0] - before[0]) / dt_s)
        for k in range(steps):
            yield (begin + (end - begin) * (k / steps))[1:], (end - begin)[1:] / (steps * dt_s)


def _turned(vector: list[float]) -> list[float]:
    """Return a vector after the third of a turn about (1, 1, 1) by which a bone that is free lies turned."""
    return [vector[2], vector[0], vector[1]]


def _model(contact: Contact) -> mujoco.MjModel:
    spec = mujoco.MjSpec()
    spec.option.timestep, spec.option.gravity = contact.dt_s, [0, 0, 0]
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    free = contact.mass_kg is not None
    quat = [0.5, 0.5, 0.5, 0.5] if free else [1.0, 0.0, 0.0, 0.0]
    bone = spec.worldbody.add_body(name="bone", quat=quat)
    tool = spec.worldbody.add_body(
        name="tool", quat=quat, pos=_turned([0.0, 0.0, 0.001]) if free else [0.0, 0.0, 0.0],
        mass=contact.mass_kg or HEAVY_KG, explicitinertial=True, inertia=[1e-4 if free else 1.0] * 3,
    )  # fmt: skip
    if free:
        bone.mass, bone.inertia, bone.explicitinertial = 2.0, [0.01, 0.01, 0.01], True
        bone.add_freejoint()
        tool.add_freejoint()
    else:
        for axis in ([1, 0, 0], [0, 0, 1]):
            tool.add_joint(type=mujoco.mjtJoint.mjJNT_SLIDE, axis=axis)
        tool.add_joint(type=mujoco.mjtJoint.mjJNT_HINGE, axis=[0, 1, 0], pos=[0, 0, 0.01])
    spec.add_mesh(name="hull", uservert=[x for corner in HULL for x in corner])
    for part in contact.parts:
        mesh = {"meshname": "hull"} if part.kind == mujoco.mjtGeom.mjGEOM_MESH else {}
        geom = tool.add_geom(
            type=part.kind, size=[*part.size_m, 0.0, 0.0, 0.0][:3], pos=[0.0, 0.0, part.low_m + part.up_m],
            quat=part.quat_wxyz, mass=0.0, contype=1, conaffinity=0, **mesh,
        )  # fmt: skip
        if contact.give_m3_n:
            spec.nuser_geom, geom.userdata = 1, [contact.give_m3_n]
    add_region(spec, name="skin", bone=bone, mesh=_mesh(curved=contact.curved), tissue=LAW, tools="tool", ledger=True)
    return spec.compile()


def _mesh(*, curved: bool) -> Mesh:
    """Return a patch of about 70 x 70 mm of triangles of 5 mm, its inward direction down: flat, or a parabola across
    whose radius of curvature on top is 50 mm."""
    n, high = 7, 0.005 * 0.866
    places, inward = [], []
    for j in range(-n, n + 1):
        for i in range(-n, n + 1):
            x, y = 0.005 * (i + 0.5 * (j % 2)), high * j
            slope = -y / 0.05 if curved else 0.0
            length = math.sqrt(1 + slope * slope)
            places.append([x, y, slope * y / 2])
            inward.append([0.0, slope / length, -1 / length])
    triangles, wide = [], 2 * n + 1
    for j in range(2 * n):
        for i in range(2 * n):
            low, high_row = j * wide + i, (j + 1) * wide + i
            # The rows of odd j, counted from the middle, stand half a step to the right.
            odd = (j - n) % 2
            first, second = (low, high_row) if not odd else (high_row, low)
            triangles += [(first, first + 1, second), (second, second + 1, first + 1)]
    corners = np.array([t if _upward(t, places) else t[::-1] for t in triangles])
    a, b, c = (np.array(places)[corners[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    area = np.sqrt(normal[:, 0] * normal[:, 0] + normal[:, 1] * normal[:, 1] + normal[:, 2] * normal[:, 2]) / 2
    areas = np.zeros(len(places))
    np.add.at(areas, corners.ravel(), np.repeat(area / 3, 3))
    middle = (a + b + c) / 3
    return Mesh(
        places=np.array(places), inward=np.array(inward), along=np.array([1.0, 0.0, 0.0]), triangles=corners,
        areas=areas, cells=2 * (middle[:, 0] > 0) + (middle[:, 1] > 0).astype(np.int64),
    )  # fmt: skip


def _upward(triangle: tuple[int, int, int], places: list[list[float]]) -> bool:
    (ax, ay, _), (bx, by, _), (cx, cy, _) = (places[k] for k in triangle)
    return (bx - ax) * (cy - ay) > (by - ay) * (cx - ax)

"""The answers of the simulated person on the indentation bench: the only module here that knows the simulator."""

from __future__ import annotations

from dataclasses import fields, replace

import mujoco
import numpy as np

from carecontact.lab.fem.cases import (
    CAP,
    DEPTHS_M,
    MATCHED_M,
    TOUCH_N,
    TRAVEL_M,
    WAYS_M,
    Answer,
    Case,
    Curve,
    Drag,
    Ground,
    Tool,
    rings,
    touch_m,
)
from carecontact.lab.validation.calibration_residual import held_out_m
from carecontact.lab.validation.result import Array
from carecontact.lab.validation.rig import SPEED_M_S, person_bench
from carecontact.lab.validation.subject import Subject
from carecontact.sim.bench import Bench, Indenter
from carecontact.tissue.plugin import Law

GLIDE_PLACES = 3
"""Number of places, of those that no fit used, at which a tool glides."""
GLUE = 20.0
"""A coefficient of friction at which nothing slips."""
GLUED_WAY_M = 0.0005
"""Distance along the surface at which the force of a glued tool gives its stiffness."""
HOLD_S = 0.2
"""Rest between the press and the motion along."""


def ground(subject: Subject, case: Case) -> Ground:
    """Return the case's ground with the thickness of the subject's tissue and the radius of the subject's limb."""
    radius = subject.scene(case.region).regions[case.region].shell.radius_m
    return replace(
        case.ground, thickness_m=subject.tissue(case.region).thickness_m,
        limb_radius_m=None if case.ground.limb_radius_m is None else radius,
    )  # fmt: skip


def answer(subject: Subject, case: Case) -> Answer:
    """Return how the person's region responds, as the mean over the places that no fit used.

    Raises SceneError if a tool does not find the region's surface.
    """
    places = held_out_m(case.region)
    curves, dimples, beside = {}, [], []
    for name, tool in case.tools().items():
        bench = person_bench(subject, case.region, indenter(tool))
        curves[name] = Curve(presses=tuple(_press(bench, place) for place in places))
        if tool == case.main:
            for x, y in places:
                bench.press(along_m=x, across_m=y, depth_m=MATCHED_M, speed_m_s=SPEED_M_S)
                places_m, inward_m, sunk_m = bench.skin()
                dimples.append(rings(places_m, inward_m) / MATCHED_M)
                beside.append(rings(places_m, sunk_m, beside=True) / MATCHED_M)
    drags = {tool.name: _drag(subject, case, tool, curves[tool.name]) for tool in case.gliding()}
    return Answer(
        curves=curves, dimple=np.nanmean(dimples, axis=0), beside=np.nanmean(beside, axis=0), drags=drags
    )  # fmt: skip


def indenter(tool: Tool) -> Indenter:
    if tool == CAP:
        return Indenter(shape="cap")
    shape = "flat" if tool.shape == "disc" else "hemisphere"
    return Indenter(shape=shape, size_m=tool.semi_axes_m[0])


def _press(bench: Bench, place: tuple[float, float]) -> tuple[Array, Array]:
    press = bench.press(along_m=place[0], across_m=place[1], depth_m=TRAVEL_M, speed_m_s=SPEED_M_S)
    return press.indentation_m, press.force_n


def _drag(subject: Subject, case: Case, tool: Tool, curve: Curve) -> Drag:
    bench = person_bench(subject, case.region, indenter(tool), glides=True)
    friction = friction_of(bench)
    declared, found, stuck = friction.copy(), [], []
    for place, press in list(zip(held_out_m(case.region), curve.presses, strict=True))[:GLIDE_PLACES]:
        depth = touch_m(*press, TOUCH_N) + DEPTHS_M[-1]
        friction[:] = declared
        found.append(_glide(bench, place, depth, WAYS_M))
        friction[:] = GLUE
        stuck.append(_glide(bench, place, depth, np.array([0.0, GLUED_WAY_M]))[0, -1] / GLUED_WAY_M)
    tangential, normal = np.mean(found, axis=0)
    return Drag(way_m=WAYS_M, force_n=tangential, normal_n=normal, stuck_n_m=float(np.mean(stuck)))


def friction_of(bench: Bench) -> Array:
    """Return the coefficient of friction (1,) in the bench's law as a view: changing it changes the law."""
    at = [field.name for field in fields(Law)].index("friction")
    return bench.model.numeric(f"{bench.region}/law").data[at : at + 1]


def _glide(bench: Bench, place: tuple[float, float], depth_m: float, way_m: Array) -> Array:
    """Return the force (2, n) [N] on the region, along it and inward, at each distance along it, after a press that
    rests at ``depth_m``."""
    bench.press(along_m=place[0], across_m=place[1], depth_m=depth_m, speed_m_s=SPEED_M_S, hold_s=HOLD_S)
    _, inward, axis = bench.place(*place)
    model, data = bench.model, bench.data
    along, press = (model.joint(name) for name in ("indenter_along", "indenter"))
    held, dt = float(data.qpos[press.qposadr[0]]), model.opt.timestep
    start = float(data.qpos[along.qposadr[0]])
    way = np.arange(0.0, way_m[-1] + 1.5 * SPEED_M_S * dt, SPEED_M_S * dt)
    force = np.zeros((len(way), 2))
    for k, moved in enumerate(way):
        data.qpos[along.qposadr[0]], data.qvel[along.dofadr[0]] = start + moved, SPEED_M_S if k else 0.0
        data.qpos[press.qposadr[0]], data.qvel[press.dofadr[0]] = held, 0.0
        mujoco.mj_step(model, data)
        felt = bench.felt.last(data, 1)[0]["force_n"]
        force[k] = felt @ axis, felt @ inward
    return np.array([np.interp(way_m, way, component) for component in (force - [force[0, 0], 0.0]).T])

"""A blow by a free mass meets the force that published stiffness predicts, and never returns momentum that is made.

A ball flies straight at a part of the settled person and is free to come back. Without losses, its largest force is
that at which the spring of the part holds the energy of the blow; on a slope, that of its motion into the surface. On
trunk and legs the spring is that of a plate (``human.hulls``), on the abdomen the published curve under the ball of the
same size that it was measured with. The robot's own tool also strikes the abdomen with all that the robot brings, and
is driven into it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product
from typing import Any, Literal

import mujoco
import numpy as np

from carecontact.errors import SceneError
from carecontact.human.hulls import ARM, FLOOR_GIVE, PLATES, REACHED_FROM_THE_SIDE, Give, plate_body
from carecontact.interface.geometry import Triangles
from carecontact.interface.robot import Tip
from carecontact.lab.validation.result import Array, CheckResult, Figure, Measure, measured
from carecontact.lab.validation.rig import ABDOMEN
from carecontact.lab.validation.subject import (
    COMFORT_ARM_DEG,
    DOWN,
    Subject,
    in_base,
    move_to,
    refuse_warnings,
    skin_points,
    surface_point,
)
from carecontact.protocol.protocol import Protocol
from carecontact.sim.simulation import Simulation, lengths
from carecontact.world.robot import make_giving
from carecontact.world.scene import Scene

REGION = "abdomen"
ABOVE_M = 0.12
"""Height over the skin from which the target goes down, so that the tool is at speed when it touches."""
STEPS = 2
"""Physics steps between two looks at the skin: 1 mm of the way at 0.25 m/s."""
HOLD_S = 0.6
"""Time for which the press goes on after the target has reached its end [s], so that the robot and the skin come to
rest there."""
BEHIND_M = 0.1
"""How far behind the tool's middle the ray begins that looks for the skin in the direction of the tool [m]; more than
any tool is thick."""
MIDDLE_PERCENT = 100.0


@dataclass(frozen=True, kw_only=True)
class Driven:
    """One press of the robot's tool into the abdomen as fast, as stiffly and as deep as a policy can, until the target
    has rested for HOLD_S or the protocol would cut the trial.

    The kernel drops a contact point that has sunk into a tool beyond the tool's middle, because the nearest surface is
    then behind it. Such a tool goes through the skin: nothing holds it until it meets bone.
    """

    tool: str
    speed_m_s: float
    """Of the tool when it touched."""
    peak_n: float
    """Largest force on a part of the person."""
    deepest_m: float
    """Of the tool's tip under where the skin was."""
    sunk: float
    """How far the skin sank into the tool at most, over half of the tool's thickness."""
    lost_n: float | None
    """Largest force until ``sunk`` passed 1; None where the skin stayed before the tool's middle."""

    def measures(self) -> Iterator[Measure]:
        name = f"abdomen, {self.tool} driven in by the robot"
        skin = f"{name}: skin in the tool, over half of its thickness"
        yield measured(f"{name}: speed at touch", self.speed_m_s, "m/s")
        yield measured(f"{name}: largest force", self.peak_n, "N")
        yield measured(f"{name}: deepest", 1000 * self.deepest_m, "mm")
        yield measured(skin, 100 * self.sunk, "%", at_most=MIDDLE_PERCENT)
        if self.lost_n is not None:
            yield measured(f"{name}: force at which it goes through", self.lost_n, "N")


def drive(subject: Subject) -> Driven:
    """Drive the tool into the middle of the abdomen with the stiffest spring that the protocol allows.

    The target moves at the protocol's speed limit. It ends so deep that the robot, wherever the tool stops, pushes with
    all of the protocol's ``force_clamp_n``. Raises SceneError if the tool leaves the region.
    """
    protocol, simulation = subject.protocol, subject.hovering(REGION)
    impedance, tip = protocol.impedance, protocol.scene.robot.tip
    top = surface_point(simulation, REGION)
    move_to(simulation, top + [0, 0, ABOVE_M], seconds=1.5)
    stiffest = impedance.translational_bounds[1]
    simulation.set_stiffness(stiffest, impedance.rotational_bounds[1])
    below = subject.tissue(REGION).thickness_m + impedance.force_clamp_n / stiffest
    seconds = (ABOVE_M + below) / protocol.physics.max_tcp_speed_m_s
    simulation.set_goal(np.r_[in_base(simulation, top - [0, 0, below]), DOWN], seconds)
    cut_n = protocol.phases.truncation_over_pain * protocol.limits.f_pain_n[REGION]
    speed, peak, deepest, sunk, lost_n = 0.0, 0.0, 0.0, 0.0, None
    for _ in range(round((seconds + HOLD_S) / (STEPS * simulation.model.opt.timestep))):
        samples = simulation.advance(STEPS)[-1]
        force = float(lengths(samples.force).max())
        if peak == 0.0:
            speed = float(samples.tcp_speed[0])
        simulation.refresh()
        share = _sunk(simulation, tip)
        if share > 1 and lost_n is None:
            lost_n = peak
        peak, sunk = max(peak, force), max(sunk, share)
        deepest = max(deepest, float(top[2] - simulation.data.site(simulation.robot.tcp_site).xpos[2]))
        if force > cut_n:
            break
    tool = protocol.scene.tool
    return Driven(tool=tool, speed_m_s=speed, peak_n=peak, deepest_m=deepest, sunk=sunk, lost_n=lost_n)


def _sunk(simulation: Simulation, tip: Tip) -> float:
    """Return how far the skin lies inside the tool, over half of the tool's thickness; 0 while it is outside."""
    corners = skin_points(simulation, REGION)[simulation.scene.regions[REGION].shell.triangles]
    out: Array = simulation.data.site(simulation.robot.tcp_site).xmat.reshape(3, 3)[:, 2]
    behind = simulation.data.geom(tip.geom).xpos - BEHIND_M * out
    ahead = float(Triangles(corners).first_hits(behind[None], out[None])[0]) - BEHIND_M
    return max(0.0, 1.0 - ahead / tip.half_m[2])


TITLE = "Knocks against trunk and legs"
MASSES_KG, SPEEDS_M_S = (1.0, 3.0, 10.0), (0.05, 0.2, 0.5)
QUICK_MASSES_KG, QUICK_SPEEDS_M_S = (1.0, 10.0), (0.2,)
BALL_M = 0.030
"""Radius of the ball that meets a plate; its contact is rigid."""
GAP_M, AFTER_S = 0.001, 0.02
LONGEST_S = 1.5
"""Longest time of a blow; the slowest one on the abdomen takes half of it."""
FAR_M, APPROACHES = 0.5, 100
"""Distance from which the ball approaches its start, and most steps of the approach."""
TOLERANCE_PERCENT = 30.0
MOMENTUM = 2.0
"""Impulse divided by the momentum of the blow: 2 if the ball returns as fast as it came, more if energy is created."""
STOPPED = 1.0
"""The same where the ball is stopped and no more. Nothing but contact acts on the ball: it has no weight and its slides
have no friction, and friction of the contact is in the force. Therefore, the impulse over the momentum is 1 plus the
ball's speed back over its speed before, and one below 1 means that the ball went on into the person."""
THROUGH_STEPS = 2
"""A ball that touches nothing for so many physics steps, and still moves inward, has gone through what it met: pressed
skin or a pressed plate pushes back until the ball stands. A single step without force is no gap, because the contact of
a plate swings in."""
BELLY_HOLDS_J = 0.47
"""Energy that the 47.5 mm of tissue of the slim bodies store if the abdomen's published curve goes on as its last 10 mm
do, in proportion to depth^1.5 (our reading). With more, no publication says whether soft tissue is left between."""
STRAY = 0.05
"""Share of the largest force from which the force on other parts is reported."""
CHEST_ASIDE_M = ((0.0, -0.085), (0.0, -0.06), (0.0, -0.03), (0.0, 0.03), (0.0, 0.04), (0.0, 0.06))
THIGH_ASIDE_M = ((0.0, -0.06), (0.0, -0.08), (0.0, -0.1), (0.0, -0.12), (0.05, -0.08), (0.1, -0.08), (0.1, -0.1))
BELLY_ASIDE_M = ((0.08, 0.0), (-0.08, 0.0), (0.0, 0.08), (0.0, -0.08), (0.08, 0.06), (-0.08, 0.06), (0.08, -0.06),
                 (-0.08, -0.06))  # fmt: skip
"""Where the scan strikes the right side of the chest (the first place is on the breastbone), the right thigh (some of
it between the thighs) and the abdomen, as ``Site.beside_m``."""
OUTWARD_M = 0.04
"""Farther outward on the chest, the ball meets the shoulder of one body and slips off another one."""
HAND_N_M = 75_000.0
"""Spring of the hand, which has no plate: ``ISO`` of "hands and fingers"."""
STRIKER = "striker"


@dataclass(frozen=True, kw_only=True)
class Site:
    """A part of the person, and its published response to a push."""

    name: str
    plate: str | None = None
    """Name of the plate that is struck; None where skin is struck, or bone without a plate."""
    hull: str | None = None
    """Name of the hull whose middle is struck; by default that of the plate's body is."""
    region: str | None = None
    """Name of the region whose skin is struck."""
    under: Give | None = None
    """Give of the plate under the skin."""
    towards: tuple[float, float, float] = (0.0, 0.0, -1.0)
    """Direction of the blow in the world."""
    ball_m: float = BALL_M
    depth_m: Array
    force_n: Array
    """(n,) published force at ``depth_m``"""
    beside_m: tuple[float, float] = (0.0, 0.0)
    """How far beside its middle the site is struck: toward the head, and toward the person's right."""
    evades: bool = False
    """Whether the site may move away from the ball as a whole, or the ball slip off it: then a blow is softer than
    predicted, and may end elsewhere or stay wedged."""

    def predicted_n(self, energy_j: float) -> float:
        """Return the force at which the published spring stores an energy; NaN if the curve ends before."""
        stored = np.r_[0.0, np.cumsum(np.diff(self.depth_m) * (self.force_n[1:] + self.force_n[:-1]) / 2)]
        return float(np.interp(energy_j, stored, self.force_n, right=np.nan))

    def most_n(self, energy_j: float) -> float:
        """Return the force at which the standard's spring of the bone under skin alone would hold an energy that the
        published curve does not reach; NaN elsewhere. Tissue over the bone can only take from it."""
        if self.under is None or np.isfinite(self.predicted_n(energy_j)):
            return np.nan
        return float(np.sqrt(2 * self.under.a_n_m * energy_j))


@dataclass(frozen=True, kw_only=True)
class Blow:
    site: str
    mass_kg: float
    speed_m_s: float
    peak_n: float
    """Largest force on the whole person."""
    predicted_n: float
    most_n: float
    evades: bool
    """These three are the site's."""
    momentum: float
    """Impulse over the momentum of the blow."""
    held: float
    """The same of what the ball met first: until it has gone through (THROUGH_STEPS), where it does. Whatever stops it
    deeper, such as bone, is not in it."""
    stray_n: float
    """Largest force on anything but the site."""
    depth_m: float
    """How deep the ball pressed what it met first: at most, or when it went through."""
    taken_j: float | None
    """Energy that this had taken from the ball when it went through; None where it did not."""

    @property
    def energy_j(self) -> float:
        return self.mass_kg * self.speed_m_s**2 / 2

    @property
    def name(self) -> str:
        return f"{self.site}, {self.mass_kg:g} kg at {self.speed_m_s:g} m/s"

    @property
    def on_one_spring(self) -> bool:
        """Whether nothing but the site bears the blow."""
        return self.stray_n <= STRAY * self.peak_n

    @property
    def off_percent(self) -> float:
        return 100 * (self.peak_n / self.predicted_n - 1)

    def measures(self, robot_j: float) -> Iterator[Measure]:
        """Yield what the blow measured, against the energy that the robot brings [J].

        The prediction always decides; if the site evades, only that the blow is not harder. No blow on the abdomen may
        be harder than the standard's spring of the abdomen predicts.
        """
        name, limit = self.name, TOLERANCE_PERCENT
        yield measured(f"{name}: largest force", self.peak_n, "N")
        if np.isfinite(self.predicted_n):
            prediction = f"the prediction of {self.predicted_n:.1f} N"
            off = f"{name}: off {prediction}"
            yield measured(off, abs(self.off_percent), "%", at_most=limit, decides=not self.evades)
            if self.evades:
                yield measured(f"{name}: harder than {prediction}", self.off_percent, "%", at_most=limit)
        elif np.isfinite(self.most_n):
            harder = f"{name}: harder than the spring of its bone, {self.most_n:.1f} N"
            yield measured(harder, 100 * (self.peak_n / self.most_n - 1), "%", at_most=limit)
        held, holds = f"{name}: impulse over momentum before it goes through", must_hold(self, robot_j)
        yield measured(f"{name}: impulse over momentum", self.momentum, at_most=MOMENTUM)
        yield measured(held, self.held, at_least=STOPPED, decides=holds)
        if np.isnan(self.predicted_n) or self.taken_j is not None:
            yield measured(f"{name}: deepest before it goes through", 1000 * self.depth_m, "mm")
        if self.taken_j is not None:
            yield measured(f"{name}: energy taken before it goes through", self.taken_j, "J")
        if not self.on_one_spring:
            yield measured(f"{name}: largest force on something else", self.stray_n, "N")


def robot_brings_j(protocol: Protocol) -> float:
    """Return the energy of the robot's declared mass at the fastest that its target moves [J]. Its effective mass is
    smaller in most directions: of random legal commands, nine of ten trials bring less, and all less than
    BELLY_HOLDS_J."""
    return protocol.impedance.effective_mass_kg * protocol.physics.max_tcp_speed_m_s**2 / 2


def must_hold(blow: Blow, robot_j: float) -> bool:
    """Whether it decides that the ball is stopped by what it met first: if a published curve reaches its energy, or the
    robot brings as much, or BELLY_HOLDS_J."""
    return not blow.evades and (bool(np.isfinite(blow.predicted_n)) or blow.energy_j <= max(robot_j, BELLY_HOLDS_J))


def sites() -> list[Site]:
    """Return the plates of the side on which the robot stands, the thigh also for a blow from the side, the bare bone
    of the arm, and the skin of the soft regions. The arm may move away as a whole, so that its sites evade."""
    depth, side = np.linspace(0.0, 0.1, 2001), REACHED_FROM_THE_SIDE
    rows = {plate.name.removeprefix(f"{side}_"): plate for plate in PLATES if plate.name.startswith(side)}

    def of(part: str, name: str, **fields: Any) -> Site:
        plate = rows[part]
        return Site(name=name, plate=plate.name, depth_m=depth, force_n=plate.give.force_n(depth), **fields)

    found = [of(part, part) for part in ("chest", "hip", "thigh", "shank")]
    # The person's right is the world's +y.
    found.append(of("thigh", "thigh from the side", towards=(0.0, -1.0, 0.0)))
    for part, name in zip(ARM, ("shoulder cap", "elbow"), strict=True):
        found.append(of(part, name, hull=f"{side}_{part}_near_end", evades=True))
    hand_n = HAND_N_M * depth
    found.append(Site(name="hand", hull=f"{side}_hand", depth_m=depth, force_n=hand_n, evades=True))
    ball = ABDOMEN.indenter.size_m
    assert ball is not None
    none = np.zeros(1)
    for part in ARM:
        skin = Site(name=part.replace("_", " "), region=part, ball_m=ball, depth_m=none, force_n=none, evades=True)
        found.append(replace(skin, under=rows[part].give))
    belly = Site(name="abdomen", region="abdomen", ball_m=ball, depth_m=ABDOMEN.depth_m, force_n=ABDOMEN.force_n)
    return [*found, replace(belly, under=FLOOR_GIVE)]


def run(subject: Subject, *, quick: bool) -> CheckResult:
    masses, speeds = (QUICK_MASSES_KG, QUICK_SPEEDS_M_S) if quick else (MASSES_KG, SPEEDS_M_S)
    blows, robot_j = list(strike_all(subject, masses, speeds)), robot_brings_j(subject.protocol)
    measures = list(_counts(blows))
    for blow in blows:
        measures += blow.measures(robot_j)
    if not quick:
        measures += scan(subject)
    measures += strike_with_tool(subject).measures(robot_j)
    try:
        measures += drive(subject).measures()
    except SceneError as error:
        # Without this measure, the others are still useful.
        name = f"abdomen, {subject.protocol.scene.tool} driven in by the robot, not measured: {error}"
        measures.append(measured(name, np.nan, "%", at_most=MIDDLE_PERCENT))
    rows = [(b.site, [b.mass_kg, b.speed_m_s, b.peak_n, b.predicted_n, not b.evades]) for b in blows]
    curves = {site.name: np.array([row for name, row in rows if name == site.name]) for site in sites()}
    return CheckResult(check="knocks", title=TITLE, measures=tuple(measures), curves=curves)


def _counts(blows: list[Blow]) -> Iterator[Measure]:
    """Yield how many blows the predictions judge; these counts have no limits."""
    predicted = [blow for blow in blows if np.isfinite(blow.predicted_n)]
    for name, evades in (("predictions that decide", False), ("predictions that do not decide", True)):
        found = [abs(blow.off_percent) > TOLERANCE_PERCENT for blow in predicted if blow.evades == evades]
        yield measured(name, len(found))
        yield measured(f"{name}, off by more than {TOLERANCE_PERCENT:g} %", sum(found))
    yield measured("blows without a prediction", len(blows) - len(predicted))


def strike_all(subject: Subject, masses: tuple[float, ...], speeds: tuple[float, ...]) -> Iterator[Blow]:
    scene, struck = subject.scene("forearm"), sites()
    state: Array | None = None
    for mass, ball in product(masses, sorted({site.ball_m for site in struck})):
        simulation = Simulation(with_striker(scene, mass, ball))
        if state is None:
            state = settled(simulation)
        for site, speed in product([site for site in struck if site.ball_m == ball], speeds):
            simulation.restore(state, comfort_arm_deg=COMFORT_ARM_DEG)
            yield strike(simulation, site, mass, speed)


def settled(simulation: Simulation) -> Array:
    simulation.settle(COMFORT_ARM_DEG)
    return simulation.integration_state()


def scan(subject: Subject) -> Iterator[Measure]:
    """Yield what blows beside the middle of a part measured: on breastbone and ribs, between the thighs, and toward the
    border of the abdomen."""
    scene, protocol, robot_j = subject.scene("forearm"), subject.protocol, robot_brings_j(subject.protocol)
    rows = {site.name: site for site in sites()}
    robots = protocol.impedance.effective_mass_kg, protocol.physics.max_tcp_speed_m_s
    for name, (mass, speed), places in (
        ("chest", (5.0, 0.2), CHEST_ASIDE_M),
        ("thigh", (10.0, 0.5), THIGH_ASIDE_M),
        ("abdomen", robots, BELLY_ASIDE_M),
    ):
        simulation = Simulation(with_striker(scene, mass, rows[name].ball_m))
        state = settled(simulation)
        for headward, right in places:
            simulation.restore(state, comfort_arm_deg=COMFORT_ARM_DEG)
            where = f"beside the middle: {name}, {1000 * headward:.0f} mm headward, {1000 * right:.0f} mm to the right"
            site = replace(rows[name], name=where, beside_m=(headward, right), evades=name == "thigh")
            try:
                blow = strike(simulation, site, mass, speed)
            except SceneError as error:
                yield measured(str(error), np.nan)
                continue
            decides = not (name == "chest" and right > OUTWARD_M)
            yield from (replace(m, decides=m.decides and decides) for m in blow.measures(robot_j))


def strike_with_tool(subject: Subject) -> Blow:
    """Return the blow of the robot's tool onto the abdomen, with the robot's declared mass and at the fastest that its
    target moves. Nothing is predicted, because the published curve is of a ball."""
    protocol, none = subject.protocol, np.zeros(1)
    mass, tip = protocol.impedance.effective_mass_kg, protocol.scene.robot.tip
    name = f"abdomen under the robot's tool ({protocol.scene.tool})"
    belly = Site(name=name, region="abdomen", ball_m=tip.half_m[2], depth_m=none, force_n=none)
    simulation = Simulation(with_striker(subject.scene("forearm"), mass, tip))
    simulation.restore(settled(simulation), comfort_arm_deg=COMFORT_ARM_DEG)
    return strike(simulation, belly, mass, protocol.physics.max_tcp_speed_m_s)


def with_striker(scene: Scene, mass_kg: float, shape: float | Tip) -> Scene:
    """Return the same world with a weightless ball of a radius [m], or tool, that moves freely without turning.

    It is a child of the robot's base, so that sensors and tissue treat it as a part of the robot.
    """
    spec = scene.spec.copy()
    base = spec.body(scene.robot.base_body)
    made = base.add_body(name=STRIKER, gravcomp=1.0)
    for name, axis in zip("xyz", np.eye(3), strict=True):
        made.add_joint(name=f"{STRIKER}_{name}", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=axis)
    if isinstance(shape, Tip):
        geom = made.add_geom(type=mujoco.mjtGeom.mjGEOM_ELLIPSOID, size=shape.half_m)
        make_giving(spec, geom, shape)
    else:
        geom = made.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[shape, 0, 0])
    geom.mass, geom.contype, geom.conaffinity = mass_kg, 1, 0
    return replace(scene, model=spec.compile(), spec=spec)


def strike(simulation: Simulation, site: Site, mass_kg: float, speed_m_s: float) -> Blow:
    """Simulate one blow on the person at rest, until the ball has left it. A ball that touches nothing but still moves
    inward has not left; after LONGEST_S, such a blow ends as well, and so does one that an evading site has wedged.
    Raises SceneError if the ball is still in contact then with any other site or has touched nothing, or if MuJoCo
    warned."""
    towards = np.array(site.towards)
    aim(simulation, site, speed_m_s * towards)
    step_s, momentum, energy = simulation.model.opt.timestep, mass_kg * speed_m_s, mass_kg * speed_m_s**2 / 2
    peak, stray, impulse, silent_s, touched, held = 0.0, 0.0, 0.0, 0.0, False, None
    start_m, depth, taken, square = _along(simulation, "qpos", towards) + GAP_M, 0.0, None, 1.0
    while silent_s < AFTER_S or _along(simulation, "qvel", towards) > 0:
        force = simulation.advance(1)[0].force[0]
        peak, stray = max(peak, float(lengths(force.sum(0)))), max(stray, stray_n(simulation, site))
        impulse += float((force @ towards).sum()) * step_s
        if not (touched or site.evades) and force.any():
            square = _squareness(simulation, towards)
        touched |= bool(force.any())
        silent_s = 0.0 if force.any() or not touched else silent_s + step_s
        if held is None and force.any():
            depth = max(depth, _along(simulation, "qpos", towards) - start_m)
        speed = _along(simulation, "qvel", towards)
        if held is None and silent_s > (THROUGH_STEPS - 0.5) * step_s and speed > 0:
            held, taken = impulse, mass_kg * (speed_m_s**2 - speed**2) / 2
        if simulation.time_s > LONGEST_S:
            if silent_s >= AFTER_S or (site.evades and touched):
                break
            fate = "has not left the person" if touched else "has touched nothing"
            raise SceneError(f"{site.name}: after {LONGEST_S} s, the ball of {mass_kg:g} kg {fate}")
    refuse_warnings(simulation, f"while the {site.name} was struck")
    return Blow(
        site=site.name,
        mass_kg=mass_kg,
        speed_m_s=speed_m_s,
        peak_n=peak,
        predicted_n=site.predicted_n(energy * square**2),
        most_n=site.most_n(energy),
        evades=site.evades,
        momentum=impulse / momentum,
        held=(impulse if held is None else held) / momentum,
        stray_n=stray,
        depth_m=depth,
        taken_j=taken,
    )


def _along(simulation: Simulation, kind: Literal["qpos", "qvel"], towards: Array) -> float:
    """Return the ball's position [m] or speed [m/s] along a direction of the world."""
    joint, into_world = simulation.model.joint(f"{STRIKER}_x"), simulation.data.body(simulation.robot.base_body).xmat
    first = int((joint.qposadr if kind == "qpos" else joint.dofadr)[0])
    return float(into_world.reshape(3, 3) @ getattr(simulation.data, kind)[first : first + 3] @ towards)


def _squareness(simulation: Simulation, towards: Array) -> float:
    """Return the cosine between a blow and the surface on which the ball lands: along a slope it keeps its speed, and
    only the motion into the surface goes into the spring. 1 on skin, which is no contact of MuJoCo's."""
    model, data = simulation.model, simulation.data
    ball = model.body(STRIKER).id
    landed = (contact for contact in data.contact if ball in model.geom_bodyid[contact.geom])
    return next((abs(float(contact.frame[:3] @ towards)) for contact in landed), 1.0)


def stray_n(simulation: Simulation, site: Site) -> float:
    """Return the sum of the ball's contact forces on bodies other than the site's plate, as no shell is."""
    model, data = simulation.model, simulation.data
    plate = model.body(plate_body(site.plate)).id if site.plate else -1
    total, wrench = 0.0, np.zeros(6)
    for number in range(data.ncon):
        bodies = model.geom_bodyid[data.contact[number].geom].tolist()
        if model.body(STRIKER).id in bodies and plate not in bodies:
            mujoco.mj_contactForce(model, data, number, wrench)
            total += float(lengths(wrench[:3]))
    return total


def aim(simulation: Simulation, site: Site, velocity: Array) -> None:
    """Put the ball GAP_M before the site, on a line through its middle, and let it fly."""
    model, data, towards = simulation.model, simulation.data, np.array(site.towards)
    base = data.body(simulation.robot.base_body)
    into_base = base.xmat.reshape(3, 3).T
    first = model.joint(f"{STRIKER}_x")
    at, dof = slice(first.qposadr[0], first.qposadr[0] + 3), slice(first.dofadr[0], first.dofadr[0] + 3)
    ball = int(model.body(STRIKER).geomadr[0])
    hulls: list[int] = []
    if site.region is not None:
        centre = surface_point(simulation, site.region, site.beside_m) - (site.ball_m + GAP_M) * towards
    else:
        hulls = [g for g in range(model.ngeom) if model.geom(g).name.startswith("human_hull_")]
        hull = data.geom(f"human_hull_{site.hull}").xpos if site.hull else None
        middle = data.body(plate_body(site.plate or "")).xipos if hull is None else hull
        # The person lies with the head toward +x and the right side toward +y.
        centre = middle - FAR_M * towards + np.array([*site.beside_m, 0.0])
    for _ in range(APPROACHES):
        data.qpos[at] = into_base @ (centre - base.xpos)
        mujoco.mj_forward(model, data)
        clear = min((mujoco.mj_geomDistance(model, data, ball, hull, FAR_M, None) for hull in hulls), default=GAP_M)
        if clear <= 2 * GAP_M:
            break
        # Nothing is nearer than that in any direction, so that the ball can move so far.
        centre = centre + (clear - GAP_M) * towards
    data.qvel[dof] = into_base @ velocity
    mujoco.mj_forward(model, data)


def draw(result: CheckResult, figure: Figure) -> None:
    figure.set_size_inches(6.0, 3.2)
    axes = figure.subplots()
    for number, (name, rows) in enumerate(result.curves.items()):
        decides = rows[:, 4] > 0
        axes.plot(rows[decides, 3], rows[decides, 2], "o", ms=3.5, color=f"C{number}")
        axes.plot(rows[~decides, 3], rows[~decides, 2], "o", ms=3.5, mfc="none", color=f"C{number}")
        axes.plot([], [], "o", ms=3.5, color=f"C{number}", label=name)
    low, high = axes.get_xlim()
    line = np.array([max(low, 0.5), high])
    axes.plot(line, line, color="0.4", lw=0.8)
    for share in (-1, 1):
        axes.plot(line, line * (1 + share * TOLERANCE_PERCENT / 100), color="0.4", lw=0.8, ls=":")
    axes.set(xscale="log", yscale="log", ylabel="largest force [N]", title="knocks")
    axes.set_xlabel("largest force that the published stiffness predicts [N]")
    axes.plot([], [], "o", ms=3.5, mfc="none", color="0.4", label="does not decide")
    axes.legend(loc="center left", bbox_to_anchor=(1.02, 0.5))

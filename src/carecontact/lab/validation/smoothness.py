"""Tests that a tool that scrubs a region glides: its force neither rattles nor drops out for single steps, at speed,
where the tool turns round, where it goes slowly, and where it glides over the plates beside the soft regions.

The arm is held, as a patient may hold it: a loose arm would move with a firm tool, and nothing would slide. Sliding
skin and tool have the friction that the protocol declares. Skin that sticks to the tool has less: soft tissue shears by
about a millimetre before it slips.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import product
from math import ceil

import mujoco
import numpy as np
import numpy.typing as npt

from carecontact.human.hulls import REACHED_FROM_THE_SIDE
from carecontact.human.shell import belly_half_width
from carecontact.interface.regions import REGIONS
from carecontact.lab.validation import knocks
from carecontact.lab.validation.passive_response import lock_arm
from carecontact.lab.validation.result import Array, CheckResult, Figure, Measure, measured
from carecontact.lab.validation.subject import (
    COMFORT_ARM_DEG,
    DOWN,
    Subject,
    axes,
    force_norm,
    in_base,
    refuse_warnings,
    skin_points,
    surface_point,
)
from carecontact.recording.schema import SEGMENTS
from carecontact.scoring.contact import low_pass
from carecontact.sim.simulation import Samples, Simulation
from carecontact.tissue.plugin import Cells

TITLE = "Smoothness of scrubbing"
FORCES_N, QUICK_FORCES_N = (5.0, 15.0), (5.0,)
SPEED_M_S, STROKES, QUICK_STROKES = 0.10, 4, 2
SLOW_M_S, SLOW_N, SLOW_STROKES = (0.010, 0.020, 0.030), 8.0, 1
"""Speeds, mean force and number of the slow strokes, which only the full form makes."""
TURNING_M_S = 0.015
"""Speed below which the tool counts as turning round, and for a moment as standing."""
HALF_WAY_M = 0.050
"""How far the tool goes to each side of the stroke's middle, where there is room for it."""
SHORTEST_WAY_M = 0.025
"""Where there is less room than that, no further strokes make up for it."""
LEAD_M, LONGEST_LEAD_M = 0.022, 0.10
"""How far beyond the end of the tool's way the target turns, at first and at most. Damping and friction keep the tool
behind the target by 23 to 55 mm: how far it went corrects the lead."""
CLEAR_M, SCAN_M = 0.002, 0.001
"""What is kept free between hand and bone, by about as much as the tool misses the ends of its way, and the step in
which ``room`` looks for it."""
LEARNING_TURNS = 5
"""After so many turns, both leads were corrected twice; from there on counts."""
STEADY = 0.7
"""Share of the speed above which the tool counts as scrubbing. Below, it reverses, where a jump of the force is
real."""
NOISE_ABOVE_HZ, NOISE_LIMIT_N = 20.0, 0.15
SAMPLE_HZ, DROP_SHARE, DROP_N = 500.0, 0.3, 0.3
SERVO_S, SERVO_RAD_S = 2.0, 6.0
GLIDE_N, GLIDE_M_S = (4.0, 8.0), (0.010, 0.060)
"""Forces and speeds of the tool that glides over plates beside the soft regions."""
GLIDE_M, BEFORE_RIM_M, LAND_S = 0.050, 0.040, 0.5
"""How far it glides, from where before the border of the abdomen, and how long it stands first."""
RIM_S = 0.05
"""Time before and after a rigid tool lands on the next plate in which a jump of its force is real and does not count; a
period of the slowest noise. Later, it may hop and land again, which no count of dropouts can tell from a rattle."""
GLIDE_KG, LINE_N_M, BRAKE_NS_M = 4.4, 1000.0, 30.0
"""Mass of the gliding tool, the spring that holds it to its line, and its damper along the force: about those of the
robot's tool."""
FRICTION_LIMIT_PERCENT, SLIDING_LIMIT_PERCENT = 2.0, 50.0


@dataclass(frozen=True, kw_only=True)
class Scrub:
    time_s: Array
    force_n: Array
    along_n: Array
    """(n, 2) horizontal part of the force."""
    steady: npt.NDArray[np.bool_]
    """(n,) whether the tool moves at speed."""
    turning: npt.NDArray[np.bool_]
    """(n,) whether it moves at less than TURNING_M_S."""
    friction: Array
    """(k,) ratio of tangential to normal force of the cells that the tool slides over, in every target period at
    speed; NaN where it slides over none."""
    sliding: Array
    """(k,) share of the normal force that these cells bear. Where it is 0 in half of the periods or more, the tool does
    not slide enough, whatever its friction is elsewhere."""
    whole_s: float
    """How long the strokes that were asked for would take on a whole way. Where there is less room, a stroke turns
    sooner, and ``scrub`` makes more of them: the time at speed is judged against this."""

    def measures(self, name: str, *, wanted: float, friction: float) -> list[Measure]:
        """Return what the scrub measured. Without a step at speed, nothing of it is a number, and no limit is met.

        Args:
            wanted: mean force that the scrub was to have [N].
            friction: the declared coefficient.
        """
        force, steady = self.force_n, self.steady
        mean = force[steady].mean() if steady.any() else np.nan
        fast_s = steady.sum() * (self.time_s[1] - self.time_s[0])
        rubbed = self.friction[~np.isnan(self.friction)]
        rubs, slides = (np.median(of) if of.size else np.nan for of in (rubbed, self.sliding))
        off, wrong = 100 * abs(mean / wanted - 1), 100 * abs(rubs / friction - 1)
        lost, declared = dropouts(self.time_s, force)[steady].sum(), "sliding friction from the declared one"
        under = "share of the force under which the tool slides"
        return [
            self._noise(name, "", force, steady),
            self._noise(name, " where it turns round", force, self.turning),
            self._noise(name, " along the skin where it turns round", self.along_n, self.turning),
            measured(f"{name}: single-step dropouts", lost, at_most=0.0),
            measured(f"{name}: deviation of the mean force from the target force", off, "%", at_most=25.0),
            measured(
                f"{name}: time at speed, of that of whole strokes", 100 * fast_s / self.whole_s, "%", at_least=25.0
            ),
            measured(f"{name}: {under}", 100 * slides, "%", at_least=SLIDING_LIMIT_PERCENT),
            measured(f"{name}: deviation of the {declared}", wrong, "%", at_most=FRICTION_LIMIT_PERCENT),
        ]

    def slow_measures(self, name: str) -> list[Measure]:
        """Return what a slow stroke measured, its turns included: how much its force rattles."""
        always = np.ones(len(self.time_s), bool)
        return [self._noise(name, "", self.force_n, always), self._noise(name, " along the skin", self.along_n, always)]

    def _noise(self, name: str, where: str, force_n: Array, counts: npt.NDArray[np.bool_]) -> Measure:
        return noise(f"{name}: force noise{where}", force_n, counts, step_s=self.time_s[1] - self.time_s[0])


def noise(name: str, force_n: Array, counts: npt.NDArray[np.bool_], *, step_s: float) -> Measure:
    """Measure the noise of a force (n,) or (n, 2), of a vector both components together."""
    parts = force_n.reshape(len(force_n), -1).T
    high = [x - low_pass(x, cutoff_hz=NOISE_ABOVE_HZ, sample_hz=1 / step_s, zero_phase=True) for x in parts]
    rms = np.sqrt(sum(x[counts].var() for x in high)) if counts.any() else np.nan
    return measured(f"{name} above 20 Hz, rms", rms, "N", at_most=NOISE_LIMIT_N)


def run(subject: Subject, *, quick: bool) -> CheckResult:
    measures: list[Measure] = []
    curves: dict[str, Array] = {}

    def held_arm(region: str) -> Simulation:
        simulation = subject.hovering(region)
        lock_arm(simulation)
        return simulation

    for region in subject.regions(quick=quick):
        friction = subject.tissue(region).friction
        for wanted in QUICK_FORCES_N if quick else FORCES_N:
            done = scrub(held_arm(region), wanted, strokes=QUICK_STROKES if quick else STROKES, region=region)
            measures += done.measures(f"{region} scrubbed with {wanted:.0f} N", wanted=wanted, friction=friction)
            curves[f"{region}/{wanted:.0f} N"] = np.stack([done.time_s, done.force_n, done.steady.astype(np.float64)])
        for speed in () if quick else SLOW_M_S:
            done = scrub(held_arm(region), SLOW_N, strokes=SLOW_STROKES, region=region, speed_m_s=speed)
            measures += done.slow_measures(f"{region} stroked at {1000 * speed:.0f} mm/s with {SLOW_N:.0f} N")
    measures += glides(subject, quick=quick)
    return CheckResult(check="smoothness", title=TITLE, measures=tuple(measures), curves=curves)


def glides(subject: Subject, *, quick: bool) -> Iterator[Measure]:
    """Yield how much the force rattles while the tool, free but held to a line and pushed down by a constant force,
    glides headward over plates, and outward from the abdomen's skin onto the flank's plate."""
    scene, tip = subject.scene("forearm"), subject.protocol.scene.robot.tip
    simulation = Simulation(knocks.with_striker(scene, GLIDE_KG, tip))
    state, headward, none = knocks.settled(simulation), (1.0, 0.0, 0.0), np.zeros(1)
    place = knocks.Site(name="", ball_m=tip.half_m[2], depth_m=none, force_n=none)
    ways = [
        (replace(place, name=f"over the {part}'s plate", plate=f"{REACHED_FROM_THE_SIDE}_{part}"), headward)
        for part in ("flank", "thigh")
    ]
    rim = (0.0, belly_half_width(scene.body) - BEFORE_RIM_M)
    onto = replace(place, name="from the abdomen onto the flank's plate", region="abdomen", beside_m=rim)
    for site, along in [*ways[: 1 if quick else None], (onto, (0.0, 1.0, 0.0))]:
        for newton, speed in product(GLIDE_N[: 1 if quick else None], GLIDE_M_S[-1:] if quick else GLIDE_M_S):
            simulation.restore(state, comfort_arm_deg=COMFORT_ARM_DEG)
            force, met_s = glide(simulation, site, newton, speed * np.array(along))
            time = np.arange(len(force)) * simulation.model.opt.timestep
            name = f"glide {site.name}, {newton:.0f} N, {1000 * speed:.0f} mm/s"
            lands = np.isfinite(met_s) and not tip.give_m3_n
            counts = np.abs(time - met_s) >= (RIM_S if lands else 0.0)
            yield noise(f"{name}: force noise", force, counts, step_s=time[1])
            if not lands:
                yield measured(f"{name}: single-step dropouts", dropouts(time, force).sum(), at_most=0.0)


def glide(simulation: Simulation, site: knocks.Site, newton: float, velocity: Array) -> tuple[Array, float]:
    """Return the magnitude (n,) of the force on the person [N], from when the tool begins to move on, and the time [s]
    since then at which it first meets another plate or bone than the site's; infinite if it never does."""
    model, data = simulation.model, simulation.data
    knocks.aim(simulation, site, np.zeros(3))
    dt, towards = model.opt.timestep, np.array(site.towards)
    into_world = data.body(simulation.robot.base_body).xmat.reshape(3, 3).copy()
    joint = model.joint(f"{knocks.STRIKER}_x")
    at, dof = (slice(first, first + 3) for first in (int(joint.qposadr[0]), int(joint.dofadr[0])))
    aside = np.eye(3) - np.outer(towards, towards)
    line, damper = into_world @ data.qpos[at], 2 * np.sqrt(LINE_N_M * GLIDE_KG)
    force, met_s = [], np.inf
    stood = round(LAND_S / dt)
    for step in range(stood + round(GLIDE_M / float(np.linalg.norm(velocity)) / dt)):
        moves = step >= stood
        line = line + moves * dt * velocity
        off, drift = line - into_world @ data.qpos[at], moves * velocity - into_world @ data.qvel[dof]
        push = aside @ (LINE_N_M * off + damper * drift) + (newton + BRAKE_NS_M * (drift @ towards)) * towards
        data.qfrc_applied[dof] = into_world.T @ push
        force.append(simulation.advance(1)[0].force[0].sum(0))
        if knocks.stray_n(simulation, site) > 0:
            met_s = min(met_s, (step - stood) * dt)
    refuse_warnings(simulation, f"while the tool glided {site.name}")
    return np.linalg.norm(force[stood:], axis=1), met_s


def dropouts(time_s: Array, force_n: Array) -> npt.NDArray[np.bool_]:
    """Return (n,) which 500 Hz samples lie more than 30 % and 0.3 N below the median of two neighbours on each side."""
    stride = max(1, round(1 / (SAMPLE_HZ * (time_s[1] - time_s[0]))))
    sampled = force_n[::stride]
    around = np.stack([np.roll(sampled, k) for k in (-2, -1, 1, 2)])
    middle = np.median(around, axis=0)
    fallen = (sampled < (1 - DROP_SHARE) * middle) & (sampled < middle - DROP_N)
    fallen[:2] = fallen[-2:] = False
    out = np.zeros(len(force_n), bool)
    out[::stride] = fallen
    return out


def scrub(simulation: Simulation, newton: float, *, strokes: int, region: str, speed_m_s: float = SPEED_M_S) -> Scrub:
    """Scrub back and forth over a region's skin at a mean force [N].

    The middle of the stroke is the place of scripted contacts, or as near to it as this tool has room to go to and fro;
    where it has less room than that, strokes are shorter and as many more. The target follows the skin's profile at
    rest under the tool. The measured force controls its depth, slowly enough (about 1 Hz) not to follow the noise.
    """
    stiffness = simulation.protocol.impedance.translational_n_m
    along, across = axes(simulation, region)
    top = surface_point(simulation, region)
    skin = skin_points(simulation, region) - top
    line = (np.abs(skin @ across) < 0.012) & (skin[:, 2] > -0.03)
    profile = np.polynomial.Polynomial.fit(skin[line] @ along, skin[line, 2], 3)
    period, dt = simulation.protocol.physics.target_period_s, simulation.model.opt.timestep
    tip = simulation.data.site(simulation.robot.tcp_site)
    depth = newton / stiffness

    def at() -> float:
        return float((tip.xpos - top) @ along)

    def go(place: float) -> list[Samples]:
        nonlocal depth
        goal = top + place * along + [0, 0, float(profile(at())) - depth]
        simulation.set_goal(np.r_[in_base(simulation, goal), DOWN], period)
        samples = simulation.advance(round(period / dt))
        depth += SERVO_RAD_S * period * (newton - force_norm(samples, REGIONS[region].segment).mean()) / stiffness
        return samples

    for _ in range(round(SERVO_S / period)):
        go(0.0)
    start = at()
    low, high = room(simulation, lambda off: off * along + [0, 0, float(profile(start + off) - profile(start))])
    ends = Ends.within(start + low, start + high)
    way = ends.high_m - ends.low_m
    made = ceil(strokes * 2 * HALF_WAY_M / max(way, SHORTEST_WAY_M) - 1e-9)
    samples: list[Samples] = []
    rubbed: list[tuple[float, float]] = []
    place = 0.0
    while ends.turns < LEARNING_TURNS + made:
        place += ends.direction * speed_m_s * period
        before = simulation.tissue[region].cells(simulation.data)
        new = go(place)
        after = simulation.tissue[region].cells(simulation.data)
        if ends.turns >= LEARNING_TURNS:
            samples += new
            if new[-1].tcp_speed[-1] > STEADY * speed_m_s:
                rubbed.append(sliding_friction(before, after, speed_m_s=float(new[-1].tcp_speed.mean())))
        ends.moved(place, at())
    time, speed, force = (
        np.concatenate([getattr(s, name) for s in samples]) for name in ("time_s", "tcp_speed", "force")
    )
    column = SEGMENTS.index(REGIONS[region].segment)
    friction, sliding = np.array(rubbed).reshape(-1, 2).T
    return Scrub(
        time_s=time - time[0],
        force_n=force_norm(samples, REGIONS[region].segment),
        along_n=force[:, column, :2],
        steady=speed > STEADY * speed_m_s,
        turning=speed < TURNING_M_S,
        friction=friction,
        sliding=sliding,
        whole_s=strokes * (len(time) * dt / made + (2 * HALF_WAY_M - way) / speed_m_s),
    )


@dataclass(kw_only=True)
class Ends:
    """Where the target turns, so that the tool, which it leads, turns at the ends of its way.

    Places are along the stroke, from the place of scripted contacts.
    """

    low_m: float
    high_m: float
    lead_m: dict[int, float]
    """Direction, 1 or -1 -> how far beyond the end of the tool's way the target turns."""
    direction: int = 1
    turns: int = 0
    farthest_m: float = -np.inf
    """Of the tool since the target last turned, in the direction in which the target went before."""

    @classmethod
    def within(cls, low_m: float, high_m: float) -> Ends:
        """Return a way as long and as near to 0 as a tool has that can go from ``low_m`` to ``high_m``."""
        half = min(HALF_WAY_M, (high_m - low_m) / 2)
        middle = min(max(0.0, low_m + half), high_m - half)
        return cls(low_m=middle - half, high_m=middle + half, lead_m={1: LEAD_M, -1: LEAD_M})

    def moved(self, target_m: float, tool_m: float) -> None:
        """Take note of where target and tool are, and turn the target if it is time."""
        now, before = self.direction, -self.direction
        self.farthest_m = max(self.farthest_m, before * tool_m)
        if now * target_m < now * self._end_m(now) + self.lead_m[now]:
            return
        if self.turns:
            short = before * self._end_m(before) - self.farthest_m
            self.lead_m[before] = min(max(0.0, self.lead_m[before] + short), LONGEST_LEAD_M)
        self.direction, self.turns, self.farthest_m = before, self.turns + 1, now * tool_m

    def _end_m(self, direction: int) -> float:
        return self.high_m if direction > 0 else self.low_m


def room(simulation: Simulation, moved: Callable[[float], Array]) -> tuple[float, float]:
    """Return how far [m] to either side the hand, as it is, could be moved before it is within CLEAR_M of anything
    rigid that no soft skin covers, such as elbow or chest; at most a whole way.

    Args:
        moved: distance along the stroke [m] -> the hand's displacement (3,) in the world [m].
    """
    model, data = simulation.model, simulation.data
    geoms = range(model.ngeom)
    wrist = model.body(simulation.robot.flange_body).id
    hand = [g for g in geoms if model.geom_bodyid[g] == wrist and model.geom_contype[g]]
    rigid = [g for g in geoms if model.geom_conaffinity[g] & 1 and not model.geom(g).name.startswith("human_core_")]
    now = data.geom_xpos[hand].copy()

    def free(off: float) -> bool:
        data.geom_xpos[hand] = now + moved(off)
        return all(
            mujoco.mj_geomDistance(model, data, mine, its, CLEAR_M, None) >= CLEAR_M for mine in hand for its in rigid
        )

    steps = range(1, round(2 * HALF_WAY_M / SCAN_M) + 1)
    low, high = (
        side * SCAN_M * (next((k for k in steps if not free(side * k * SCAN_M)), steps.stop) - 1) for side in (-1, 1)
    )
    data.geom_xpos[hand] = now
    return low, high


def sliding_friction(before: Cells, after: Cells, *, speed_m_s: float) -> tuple[float, float]:
    """Return the ratio of tangential to normal force of the cells over which the tool slid, at STEADY of its speed or
    more between the two readings, and their share of the normal force; (nan, 0) if there are none."""
    press, shear, slip, touch = (
        getattr(after, name) - getattr(before, name) for name in ("press_ns", "shear_ns", "slip_m3", "touch_m2s")
    )
    slides = slip > STEADY * speed_m_s * touch
    pressed = press[slides].sum()
    return (float(shear[slides].sum() / pressed), float(pressed / press.sum())) if pressed > 0 else (np.nan, 0.0)


def draw(result: CheckResult, figure: Figure) -> None:
    names = [name.partition("/") for name in result.curves]
    regions = list(dict.fromkeys(region for region, *_ in names))
    figure.set_size_inches(5.0, 1.2 + 1.5 * len(regions))
    rows = figure.subplots(len(regions), squeeze=False, sharex=True)[:, 0]
    for row, region in zip(rows, regions, strict=True):
        for _, _, force_text in (name for name in names if name[0] == region):
            time, force, steady = result.curves[f"{region}/{force_text}"]
            (line,) = row.plot(time, np.where(steady > 0, force, np.nan), lw=0.8, label=f"about {force_text}")
            row.plot(time, force, lw=0.5, color=line.get_color(), alpha=0.4)
        row.set(ylabel="force [N]", ylim=(0, None), title=region.replace("_", " "))
        row.legend(loc="upper right")
    rows[-1].set_xlabel(f"time [s], scrubbing at {SPEED_M_S:.1f} m/s (pale: turning)")

"""Where should the robot stand? An inverse-kinematics study that chooses the base, its yaw and the parked posture.

    python tools/reachability.py --figure reachability.png [--write src/carecontact/protocols/NAME.toml]
    python tools/reachability.py --check    does the protocol's place serve every shipped body?
    python tools/reachability.py --places ALONG_M ACROSS_M YAW_DEG    and the person wherever a seed may lay it?

For every candidate base the tool must point down at nine points of the person (forearm, upper arm, abdomen; middle and
+-60 mm along the axis), 80 mm above and 20 mm below the skin, for three comfort angles. A base is scored by its worst
target: margin to the joint limits, manipulability, and effective mass along the vertical, which raises impact peaks.
"""

from __future__ import annotations

import argparse
import re
from collections import Counter
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np
import numpy.typing as npt

from carecontact.episode.base_placement import Base, lying_person
from carecontact.human.library import body_names
from carecontact.human.pose import RIGHT_SHOULDER_M
from carecontact.protocol.load import load_protocol
from carecontact.protocol.overrides import overridden
from carecontact.protocol.protocol import Protocol
from carecontact.world.arm_kinematics import Arm, follow, pointing_down
from carecontact.world.draws import Place

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
ABOVE_M, BELOW_M = 0.08, -0.02
COMFORT_DEG = (45.0, 52.5, 60.0)
TOOL_YAWS = np.deg2rad(np.arange(0, 360, 30.0))
ELBOW_SEEDS = ((0.0, -0.3, 0.0, -2.2, 0.0, 2.0, 0.0), (0.9, 0.3, -0.9, -2.2, 0.5, 2.2, 0.0),
               (-0.9, 0.3, 0.9, -2.2, -0.5, 2.2, 0.0))  # fmt: skip
BASE_RADIUS_M = 0.10
BED_HALF_WIDTH_M = 0.45
BED_GAP_M = 0.15
"""Base axis to the mattress edge, for a base that is lower than the mattress top."""
SHIFTS_M = ((0.04, 0, 0), (-0.04, 0, 0), (0, -0.04, 0), (0, 0.04, 0), (0.03, -0.03, -0.03))
"""The person may settle, or be built, a little elsewhere: a base must reach the targets moved by each of these too."""
PARKED_GAP_M = 0.15
"""Horizontal distance of the parked tool from every target and arm joint."""
PARKED_REACH_M = 0.28
"""Least horizontal distance of the parked tool from the base axis."""
LINK_CLEARANCE_M = 0.09
"""Half thickness of the forearm links, kept free above the mattress at the elbow, forearm and wrist."""


CENTRING = 0.12


def inverse(
    arm: Arm, position: np.ndarray, rotation: np.ndarray, seed: np.ndarray, *, iterations: int = 60
) -> tuple[np.ndarray, np.ndarray]:
    """Solve for postures (B, joints) by damped least squares, with joints centred in the null space; return them
    and the pose errors (B,).
    """
    middle, half = arm.range.mean(1), np.ptp(arm.range, axis=1) / 2
    q = seed.copy()
    for k in range(iterations):
        links = arm.links(q)
        jacobian = arm.jacobian(links)
        step = arm.pose_error(links, position, rotation)
        scale = np.minimum(1.0, 0.5 / np.maximum(np.linalg.norm(step, axis=1, keepdims=True), 1e-9))
        damped = jacobian @ jacobian.swapaxes(1, 2) + 1e-5 * np.eye(6)
        inverse = np.linalg.solve(damped, jacobian).swapaxes(1, 2)
        # The cubic hardly moves joints in mid-range and pushes those near a limit back.
        wish = -CENTRING * ((q - middle) / half) ** 3 * half * (k < iterations - 12)
        task = (jacobian @ wish[:, :, None])[:, :, 0]
        q = q + (inverse @ (step * scale - task)[:, :, None])[:, :, 0] + wish
        q = np.clip(q, arm.range[:, 0], arm.range[:, 1])
    return q, np.linalg.norm(arm.pose_error(arm.links(q), position, rotation), axis=1)


@dataclass(frozen=True, kw_only=True)
class Targets:
    """Skin points of the supine person in world."""

    skin: Array
    """(N, 3)"""
    label: list[str]
    arms: Array
    """(A, 3, 3) shoulder, elbow, wrist for every comfort angle"""

    @property
    def poses(self) -> Array:
        """(2 N, 3) above and below the skin."""
        return np.concatenate([self.skin + np.array([0, 0, ABOVE_M]), self.skin + np.array([0, 0, BELOW_M])])


def person_targets(protocol: Protocol) -> Targets:
    """Where the skin of the protocol's body lies once it has settled, for every comfort angle; the abdomen's as it lies
    with the last of them."""
    people = [lying_person(protocol, angle) for angle in COMFORT_DEG]
    of_arm = [protocol.regions.index(name) for name in ("upper_arm", "forearm")]
    abdomen = protocol.regions.index("abdomen")
    skin = [person.skin[row] for person in people for row in of_arm] + [people[-1].skin[abdomen]]
    label = [name for _ in people for name in ("upper_arm", "forearm") for _ in range(3)] + ["abdomen"] * 3
    return Targets(skin=np.concatenate(skin), label=label, arms=np.array([person.limb[:3] for person in people]))


def candidate_bases(protocol: Protocol) -> Array:
    """(N, 3), clear of the mattress edge and of the arm board."""
    grid = np.array([
        (x, y, z) for z in (0.55, 0.62, 0.70)
        for x, y in [(x, y) for x in np.arange(-0.40, 0.01, 0.04) for y in np.arange(0.55, 0.76, 0.05)]
        + [(x, 1.0) for x in (0.0, 0.1, 0.2, 0.3)]
    ])  # fmt: skip
    low, high = np.array(protocol.scene.board_low_m), np.array(protocol.scene.board_high_m)
    outside = np.linalg.norm(np.maximum(np.maximum(low - grid[:, :2], grid[:, :2] - high), 0), axis=1)
    beside = (grid[:, 1] > BED_HALF_WIDTH_M + BED_GAP_M - 1e-9) | (grid[:, 2] >= protocol.scene.mattress_top_m)
    return grid[(outside > BASE_RADIUS_M - 1e-9) & beside]


@dataclass(frozen=True, kw_only=True)
class Study:
    """Per target of one base and yaw: the best posture over tool yaws and elbow seeds."""

    q: Array
    margin: Array
    manipulability: Array
    effective_mass_kg: Array
    reached: Mask

    @property
    def score(self) -> float:
        """Unreached targets rule a base out; otherwise the worst margin leads and the others break ties."""
        if not self.reached.all():
            return -float((~self.reached).sum())
        low = (
            self.margin.min() + 2.0 * self.manipulability.min() - 0.02 * float(np.quantile(self.effective_mass_kg, 0.9))
        )
        return float(low)


def base_yaw_deg(base: Array, targets: Targets) -> float:
    """Toward the middle of the targets, to 15 degrees."""
    d = targets.skin.mean(0) - base
    return float(np.round(np.rad2deg(np.arctan2(d[1], d[0])) / 15) * 15)


def study_base(arm: Arm, base: Array, yaw_deg: float, targets: Targets) -> Study:
    points = targets.poses
    turn = turned(yaw_deg)
    local = (points - base) @ turn
    n, y, s = len(points), len(TOOL_YAWS), len(ELBOW_SEEDS)
    position = np.repeat(local, y * s, 0)
    rotation = np.tile(np.repeat(turn.T @ pointing_down(TOOL_YAWS), s, 0), (n, 1, 1))
    seed = np.tile(np.array(ELBOW_SEEDS), (n * y, 1))
    seed[:, 0] += np.arctan2(position[:, 1], position[:, 0]) * 0.5
    q, error = inverse(arm, position, rotation, seed)
    margin = arm.margin(q)
    manipulability, mass = arm.measures(q)
    heights = arm.links(q)[:, [3, 4, 5, 6], 2, 3] + base[2]
    low = heights.min(1) < 0.62 + LINK_CLEARANCE_M
    value = np.where((error < 1e-3) & ~low, margin + manipulability - 0.01 * mass, -10.0).reshape(n, -1)
    pick = np.arange(n) * y * s + value.argmax(1)
    return Study(
        q=q[pick], margin=margin[pick], manipulability=manipulability[pick], effective_mass_kg=mass[pick],
        reached=(value.max(1) > -10) & (margin[pick] > 0.02),
    )  # fmt: skip


def clear_of_view(links: Array, base: Array, turn: Array, protocol: Protocol, targets: Targets) -> Mask:
    """(B,) no part of the arm, widened to its thickness, lies between overhead camera and the person's right side."""
    origins = links[:, :, :3, 3] @ turn.T + base
    points = [origins[:, :-1] + t * (origins[:, 1:] - origins[:, :-1]) for t in (0.0, 0.5, 1.0)]
    points = np.concatenate(points, 1)
    eye, plane_z = np.array(protocol.cameras["overhead"].position_m), protocol.scene.mattress_top_m + 0.08
    grow = (eye[2] - plane_z) / (eye[2] - points[..., 2])
    shadow = eye[:2] + (points[..., :2] - eye[:2]) * grow[..., None]
    radius = 0.09 * grow
    free = np.full(len(links), True)
    for shoulder, elbow, wrist in targets.arms:
        fingertip = wrist + (wrist - elbow) * 0.75
        for a, b in ((shoulder, elbow), (elbow, fingertip)):
            ab = (b - a)[:2]
            t = np.clip((shadow - a[:2]) @ ab / (ab @ ab), 0, 1)
            gap = np.linalg.norm(shadow - a[:2] - t[..., None] * ab, axis=-1) - radius
            free &= (gap > 0.08).all(1)
    return free & (shadow[..., 1] - radius > 0.22).all(1)


@dataclass(frozen=True, kw_only=True)
class Parked:
    """One parked posture and how its straight paths to every target fare."""

    q: Array
    tcp_world: Array
    margin: float
    manipulability: float
    effective_mass_kg: float
    error: float
    score: float


def limb_yaws(targets: Targets, start_yaw: float) -> Array:
    """(N,) tool yaw that puts the cap across the limb or trunk; of two, the nearer to the start."""
    per_arm = [np.arctan2(*(arm[2] - arm[1])[1::-1]) for arm in targets.arms]
    yaw = np.array([*np.repeat(per_arm, 6), 0.0, 0.0, 0.0])
    return yaw + np.round((start_yaw - yaw) / np.pi) * np.pi


def study_parked(arm: Arm, base: Array, yaw_deg: float, protocol: Protocol, targets: Targets) -> list[Parked]:
    """Every parked posture of a grid that the overhead camera does not mind, best first."""
    turn = turned(yaw_deg)
    spots = np.array(np.meshgrid(np.arange(-0.4, 0.11, 0.1), np.arange(0.5, 0.81, 0.1), (1.0, 1.1))).reshape(3, -1).T
    points = np.concatenate([targets.arms.reshape(-1, 3), targets.skin])
    gap = np.linalg.norm(spots[:, None, :2] - points[None, :, :2], axis=2).min(1)
    spots = spots[gap > PARKED_GAP_M]
    yaws = np.deg2rad(np.arange(-180, 180, 45.0))
    position = np.repeat((spots - base) @ turn, len(yaws), 0)
    tool_yaw = np.tile(yaws, len(spots))
    seed = np.tile(np.array(ELBOW_SEEDS[0]), (len(position), 1))
    seed[:, 0] = np.clip(np.arctan2(position[:, 1], position[:, 0]), -2.5, 2.5)
    q, error = inverse(arm, position, turn.T @ pointing_down(tool_yaw), seed)
    links = arm.links(q)
    good = (error < 1e-4) & (arm.margin(q) > 0.25) & clear_of_view(links, base, turn, protocol, targets)
    good &= np.linalg.norm(position[:, :2], axis=1) > PARKED_REACH_M
    found = []
    points = (targets.poses - base) @ turn
    for i in np.flatnonzero(good):
        parked = np.tile(q[i], (2 * len(points), 1))
        start = np.full(len(parked), tool_yaw[i])
        goal_yaw = np.concatenate([start[: len(points)], np.tile(limb_yaws(targets, tool_yaw[i]), 2)])
        path, error_i = follow(arm, parked, np.tile(points, (2, 1)), goal_yaw, start, turn)
        flat = path.reshape(-1, 7)
        margin = float(arm.margin(flat).min())
        manipulability, _ = arm.measures(flat)
        ends = arm.measures(path[-1])[1]
        distance = float(np.linalg.norm(points - links[i, 8, :3, 3], axis=1).mean())
        worst = float(manipulability.min())
        score = margin + 2 * worst - 0.02 * float(ends.max()) - 0.2 * distance - 10 * float(error_i.max() > 2e-3)
        tcp = turn @ links[i, 8, :3, 3] + base
        found.append(Parked(q=q[i], tcp_world=tcp, margin=margin, manipulability=worst,
                            effective_mass_kg=float(ends.max()), error=float(error_i.max()), score=score))  # fmt: skip
    return sorted(found, key=lambda p: -p.score)


@dataclass(frozen=True, kw_only=True)
class Served:
    """How the protocol's own base and parked posture serve some targets."""

    missed: tuple[str, ...]
    """Targets without a posture, or lost on the straight path from the parked one."""
    room_m: float
    """Of the targets inside the workspace."""
    text: str

    @property
    def all(self) -> bool:
        return not self.missed and self.room_m > 0


def serve(arm: Arm, protocol: Protocol, targets: Targets) -> Served:
    base, yaw_deg = np.array(protocol.scene.robot_base_m), protocol.scene.robot_yaw_deg
    turn = turned(yaw_deg)
    box = np.array([protocol.impedance.workspace_low_m, protocol.impedance.workspace_high_m])
    study = study_base(arm, base, yaw_deg, targets)
    points = (targets.poses - base) @ turn
    parked = np.tile(np.array(protocol.scene.parked_joint_rad), (len(points), 1))
    tool = turn @ arm.links(parked[:1])[0, 8, :3, :3]
    start = np.full(len(points), np.arctan2(tool[1, 0], tool[0, 0]))
    path, error = follow(arm, parked, points, np.tile(limb_yaws(targets, start[0]), 2), start, turn)
    margin = arm.margin(path.reshape(-1, 7)).reshape(path.shape[:2]).min(0)
    room = float(np.minimum(points - box[0], box[1] - points).min())
    heights = ("above", "below")
    missed = tuple(
        f"{targets.label[k % len(targets.label)]} {heights[k // len(targets.label)]}"
        for k in np.flatnonzero(~study.reached | (error > 2e-3))
    )
    worst = int(margin.argmin())
    text = (
        f"{'misses ' + ', '.join(missed) if missed or room <= 0 else 'reaches all'}; "
        f"margin {study.margin.min():.3f}, manipulability {study.manipulability.min():.3f}; along paths from "
        f"parked margin {margin.min():.3f} ({targets.label[worst % len(targets.label)]}), error {error.max():.1e}; "
        f"{room * 1000:.0f} mm inside the workspace"
    )
    return Served(missed=missed, room_m=room, text=text)


def check_bodies(arm: Arm, protocol: Protocol) -> bool:
    """Print how the protocol's place serves every shipped body; True if everything is reached."""
    good = True
    for name in body_names():
        served = serve(arm, protocol, person_targets(overridden(protocol, {"person.body": name})))
        good &= served.all
        print(f"{name:18} {served.text}")
    return good


def check_places(arm: Arm, protocol: Protocol, most: Place) -> bool:
    """Print what is out of reach with the protocol's body at every corner of a range; True if every region's middle can
    be touched there: 20 mm below the skin, tool straight down, at every comfort angle. Otherwise also the largest share
    of the range, in steps of 5 %, of which that is so.

    Less than is asked of a base: the ends of a scrub and the place 80 mm above are shown and do not count.
    """
    here = person_targets(protocol)
    base, yaw_deg, n = np.array(protocol.scene.robot_base_m), protocol.scene.robot_yaw_deg, len(here.label)

    def out_of_reach(signs: tuple[int, ...], share: float) -> tuple[Place, list[int]]:
        along_m, across_m, yaw = (share * np.array(signs) * (most.along_m, most.across_m, most.yaw_deg)).tolist()
        place = Place(along_m=along_m, across_m=across_m, yaw_deg=yaw)
        return place, np.flatnonzero(~study_base(arm, base, yaw_deg, moved(here, place)).reached).tolist()

    def middles(missed: list[int]) -> int:
        return sum(k >= n and k % 3 == 1 for k in missed)

    lost: dict[tuple[int, ...], int] = {}
    for signs in product((-1, 1), repeat=3):
        place, missed = out_of_reach(signs, 1.0)
        lost[signs], gap = middles(missed), board_gap(protocol, place)
        lacking = Counter(f"{here.label[k % n]} {'below' if k >= n else 'above'}" for k in missed)
        print(f"{place.along_m:+.3f} m {place.across_m:+.3f} m {place.yaw_deg:+5.1f} deg  "
              f"out of reach: {', '.join(f'{k} {what}' for what, k in lacking.items()) or 'nothing'}; "
              f"middles to touch of it: {lost[signs]}; board {gap * 1000:.0f} mm off the base", flush=True)  # fmt: skip
    if not any(lost.values()):
        return True
    worst_first = sorted(lost, key=lambda signs: -lost[signs])
    for share in np.arange(0.95, 0.0, -0.05):
        if not any(middles(out_of_reach(signs, share)[1]) for signs in worst_first):
            print(f"every middle can be touched at every corner of {share:.2f} of it")
            break
    return False


def turned(yaw_deg: float) -> Array:
    """(3, 3) rotation about the vertical."""
    return Base(position_m=(0.0, 0.0, 0.0), yaw_deg=yaw_deg).turn


def moved(targets: Targets, place: Place) -> Targets:
    """The targets of the person at a place, who settles there as here, to 3 mm (tests/sim/test_simulation.py)."""
    return replace(targets, skin=place.moved(targets.skin), arms=place.moved(targets.arms))


def board_gap(protocol: Protocol, place: Place) -> float:
    """Horizontal distance of the moved arm board's edge from the base [m]; negative where they meet."""
    low, high = np.array(protocol.scene.board_low_m), np.array(protocol.scene.board_high_m)
    shoulder, rotation = np.array(RIGHT_SHOULDER_M), turned(place.yaw_deg)[:2, :2]
    base = np.array(protocol.scene.robot_base_m[:2]) - [place.along_m, place.across_m] - shoulder
    local = rotation.T @ base + shoulder
    return float(np.linalg.norm(np.maximum(np.maximum(low - local, local - high), 0))) - BASE_RADIUS_M


def workspace_box(
    base: Array, yaw_deg: float, parked: Parked, protocol: Protocol, targets: Targets
) -> tuple[Array, Array]:
    """Box in base around all targets and the parked tool, 0.2 m wider, down to 20 mm under the mattress top."""
    turn = turned(yaw_deg)
    points = (np.concatenate([targets.poses, parked.tcp_world[None]]) - base) @ turn
    low, high = points.min(0) - 0.2, points.max(0) + 0.2
    low[2] = protocol.scene.mattress_top_m - 0.02 - base[2]
    return np.floor(low * 20) / 20, np.ceil(high * 20) / 20


def draw(path: Path, rows: list[tuple[Array, float, Study]], base: Array, parked: Parked, targets: Targets) -> None:
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.8), layout="constrained")
    level = [(b, s) for b, _, s in rows if b[2] == base[2]]
    worst = [s.margin.min() if s.reached.all() else np.nan for _, s in level]
    dots = left.scatter([b[0] for b, _ in level], [b[1] for b, _ in level], c=worst, s=170, marker="s", cmap="viridis")
    left.scatter(*np.array([b[:2] for b, s in level if not s.reached.all()]).T, c="0.8", s=30, marker="x")
    left.plot(base[0], base[1], "r+", ms=14, mew=2)
    left.set(xlabel="base x [m]", ylabel="base y [m]", title=f"base z = {base[2]:.2f} m; x: not all targets reached")
    figure.colorbar(dots, ax=left, label="worst joint margin (share of half range)")
    right.add_patch(plt.Rectangle((-1, -0.45), 2, 0.9, fc="0.93", ec="0.6"))
    for arm in targets.arms:
        right.plot(arm[:, 0], arm[:, 1], "-", c="0.6", lw=5, solid_capstyle="round")
    right.plot(targets.skin[:, 0], targets.skin[:, 1], "o", ms=4, c="tab:blue", label="targets")
    right.plot(base[0], base[1], "s", ms=11, c="tab:red", label="base")
    right.plot(parked.tcp_world[0], parked.tcp_world[1], "^", ms=8, c="tab:orange", label="parked tool")
    right.set(xlabel="x, to the head [m]", ylabel="y, to the person's right [m]", xlim=(-0.8, 0.8), ylim=(-0.5, 1.0))
    right.set_aspect("equal")
    right.legend(loc="upper left", fontsize=8)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=90)


def write_scene(path: Path, base: Array, yaw_deg: float, parked: Parked, box: tuple[Array, Array]) -> None:
    """Replace the five values in a protocol file, leaving the rest of its text alone."""
    text = path.read_text()
    values = {
        "robot_base_m": base, "robot_yaw_deg": yaw_deg, "parked_joint_rad": np.round(parked.q, 4),
        "workspace_low_m": box[0], "workspace_high_m": box[1],
    }  # fmt: skip
    for name, value in values.items():
        spelled = str(np.round(value, 4).tolist()) if isinstance(value, np.ndarray) else str(value)
        text, n = re.subn(rf"(?m)^{name} = .*$", f"{name} = {spelled}", text)
        if n != 1:
            raise SystemExit(f"{path}: {n} lines start with {name!r}, expected one")
    path.write_text(text)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--protocol", default="bathing-v3")
    parser.add_argument("--figure", type=Path)
    parser.add_argument("--write", type=Path, help="protocol file to edit in place")
    parser.add_argument("--finalists", type=int, default=3, help="bases whose paths from a parked posture are studied")
    parser.add_argument("--check", action="store_true", help="only check the protocol's place, with every shipped body")
    parser.add_argument("--places", type=float, nargs=3, metavar=("ALONG_M", "ACROSS_M", "YAW_DEG"),
                        help="only check it with the person moved by so much either way")  # fmt: skip
    options = parser.parse_args()
    protocol = load_protocol(options.protocol)
    arm = Arm(protocol.scene.robot)
    if options.check:
        raise SystemExit(0 if check_bodies(arm, protocol) else 1)
    if options.places:
        along_m, across_m, yaw_deg = options.places
        most = Place(along_m=along_m, across_m=across_m, yaw_deg=yaw_deg)
        raise SystemExit(0 if check_places(arm, protocol, most) else 1)
    targets = person_targets(protocol)
    rows = [
        (base, base_yaw_deg(base, targets), study_base(arm, base, base_yaw_deg(base, targets), targets))
        for base in candidate_bases(protocol)
    ]
    robust = {
        tuple(base): min(
            study_base(arm, base, yaw_deg, replace(targets, skin=targets.skin + np.array(shift))).score
            for shift in ((0, 0, 0), *SHIFTS_M)
        )
        for base, yaw_deg, study in rows
        if study.reached.all()
    }
    rows = sorted(rows, key=lambda row: -robust.get(tuple(row[0]), row[2].score - 100.0))
    reached = sum(bool(s.reached.all()) for _, _, s in rows)
    steady = sum(score > 0 for score in robust.values())
    print(f"{len(rows)} bases; {reached} reach all {2 * len(targets.label)} targets, {steady} also with every shift")
    best: tuple[Array, float, Parked] | None = None
    for base, yaw_deg, study in rows[: options.finalists]:
        worst = f"margin {study.margin.min():.3f}, manipulability {study.manipulability.min():.3f}"
        shifted = robust.get(tuple(base), float("nan"))
        print(
            f"base {base.round(3)} yaw {yaw_deg:.0f} deg: score {study.score:.3f}, with shifts {shifted:.3f}; "
            f"{worst}, effective mass {study.effective_mass_kg.max():.1f} kg"
        )
        found = study_parked(arm, base, yaw_deg, protocol, targets)
        for parked in found[:2]:
            print(
                f"  parked {parked.q.round(3)}, tool at {parked.tcp_world.round(2)}; along paths margin "
                f"{parked.margin:.3f}, manipulability {parked.manipulability:.3f}, at targets effective mass "
                f"{parked.effective_mass_kg:.1f} kg, error {parked.error:.1e}"
            )
        if found and (best is None or found[0].score > best[2].score):
            best = (base, yaw_deg, found[0])
    if best is None:
        raise SystemExit("no base has a parked posture from which every path is clear")
    base, yaw_deg, parked = best
    box = workspace_box(base, yaw_deg, parked, protocol, targets)
    print(f"chosen: base {base.round(3).tolist()} m, yaw {yaw_deg:.0f} deg")
    print(f"workspace {box[0].tolist()} to {box[1].tolist()} m in base")
    if options.figure:
        draw(options.figure, rows, base, parked, targets)
    if options.write:
        write_scene(options.write, base, yaw_deg, parked, box)


if __name__ == "__main__":
    main()

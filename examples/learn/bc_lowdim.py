"""Behaviour cloning on 43 numbers: from demonstrations to a policy in about a minute, with numpy alone.

    carecontact demonstrate --protocol bathing-wide-v2 --persons 40 --noise 4mm --tasks T1,T3 --out demos
    python bc_lowdim.py demos --out bc.npz
    carecontact run --policy bc_lowdim:BehaviourCloning --policy-arg weights=bc.npz \\
        --protocol bathing-wide-v2 --level L1 --tasks T1,T3 --seeds 0-8 --out bc

The last command, with --control shuffled-look behind it, shows what the policy owes to its one look.

The policy looks once, with the arm out of the way, and finds the forearm, and the foam if the instruction names it.
They give a frame. In it stand the tool, its last target, and how far the tool lags behind: the hand feels through this
lag. A network of three hidden layers maps these numbers to the next second of targets.
"""

import argparse
import time
from itertools import pairwise

import numpy as np
from demonstrations import demonstration, each

from carecontact.interface.action import Action
from carecontact.interface.body_view import PerceptionFailure, region_from_observation
from carecontact.interface.policy import PolicyCard
from carecontact.policies.foam import find_foam, names_foam
from carecontact.policies.point_flow import CHUNK, EXECUTED, HZ, SMALL_M, SMALL_RAD, targets, travelled, turn

CARD = {
    "modalities": ("rgb", "depth", "points", "masks", "landmarks"),
    "cameras": ("overhead",),
    "camera_hz": {"overhead": 0.0},
}


class Place:
    """Where to touch, as it was seen: a frame with its origin on the skin, x along the foam or the forearm, z up."""

    def __init__(self, seen):
        """Raises PerceptionFailure where the forearm or its foam is not found."""
        region = region_from_observation(seen, "forearm")
        ways = np.linspace(-0.8, 0.8, 9)[:, None]
        if names_foam(seen.instruction):
            foam = find_foam(seen.cameras["overhead"], region)
            centre, along, out, half = foam.centre_on_skin, foam.along, foam.out, foam.half_m
            skin = foam.on_skin(centre + ways * half[0] * along)
        else:
            centre, along, out = region.centre_m, region.axis, region.normal
            half = region.half_length_m, region.radius_m
            skin = np.array([region.surface(way) for way in ways[:, 0] * half[0]])
        cos, sin = along[:2] / np.linalg.norm(along[:2])
        self.axes = np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])
        slope, height = np.polyfit(ways[:, 0], skin[:, 2], 1)
        self.origin = np.append(centre[:2], height)
        spot = [cos, sin, *half, 10 * slope, self.axes[1] @ out, float(names_foam(seen.instruction))]
        limb = [*self.at(region.centre_m), *(self.axes @ region.axis), region.half_length_m, region.radius_m]
        self.numbers = np.concatenate(
            [spot, 10 * (skin[:, 2] - height - slope * ways[:, 0]), limb, self.at(np.zeros(3))]
        )

    def at(self, place):
        return self.axes @ (place - self.origin)


def features(place, tool, target, first, time_s, way_m, scrubs):
    """(43,) numbers. ``tool``, ``target``, ``first``: (7,) the tool, its last target, and where it was at first."""
    at, goal = place.at(tool[:3]), place.at(target[:3])
    clock = [time_s / 10, min(time_s, 3.0), way_m, float(scrubs)]
    return np.concatenate([at, goal, np.arcsinh((goal - at) / SMALL_M), turn(first, target), place.numbers, clock])


def windows(path):
    """Return the features (N, 43), the following second (N, 121) of every step of a demonstration, and its salt; None
    where the person is not found."""
    shown = demonstration(path, PolicyCard(name="look", **CARD))
    try:
        place = Place(shown.looks[0])
    except PerceptionFailure:
        return None
    first, count, scrubs = shown.tool[0], len(shown.given), "scrub" in shown.looks[0].instruction
    way = np.append(0.0, travelled(shown.wanted, first))
    x, y = [], []
    for k in range(count):
        last = shown.given[k - 1] if k else first
        ahead = shown.wanted[np.minimum(np.arange(k, k + CHUNK), count - 1)]
        places = (ahead[:, :3] - last[:3]) @ place.axes.T
        turns = [turn(last, pose) for pose in ahead]
        x.append(features(place, shown.tool[k], last, first, k / HZ, way[k], scrubs))
        steps = np.arcsinh(places / SMALL_M), np.arcsinh(np.array(turns) / SMALL_RAD)
        y.append(np.concatenate([*map(np.ravel, steps), [min((count - k) / CHUNK, 2.0)]]))
    return np.array(x), np.array(y), shown.salt


def forward(weights, x):
    for k in range(0, len(weights), 2):
        x = x @ weights[k] + weights[k + 1]
        if k + 2 < len(weights):
            x = x / (1 + np.exp(-x))
    return x


def train(x, y, *, width=192, steps=5000, batch=256, rate=2e-3, seed=0):
    """Fit the network by Adam on the smooth absolute error, with noise on its inputs. Return its weights."""
    rng = np.random.default_rng(seed)
    sizes = [x.shape[1], width, width, width, y.shape[1]]
    weights = []
    for inputs, outputs in pairwise(sizes):
        weights += [rng.normal(0, inputs**-0.5, (inputs, outputs)).astype("f4"), np.zeros(outputs, "f4")]
    first, second = ([np.zeros_like(w) for w in weights] for _ in range(2))
    for step in range(1, steps + 1):
        rows = rng.integers(len(x), size=batch)
        inputs = x[rows] + 0.03 * rng.standard_normal((batch, x.shape[1]), "f4")
        layers, sums, total = [inputs], [], inputs
        for k in range(0, len(weights), 2):
            total = layers[-1] @ weights[k] + weights[k + 1]
            sums.append(total)
            layers.append(total / (1 + np.exp(-total)) if k + 2 < len(weights) else total)
        back = np.clip(total - y[rows], -1, 1) / batch
        slow = rate * min(step / 200, 0.5 * (1 + np.cos(np.pi * step / steps)))
        for k in range(len(weights) - 2, -1, -2):
            if k + 2 < len(weights):
                sigmoid = 1 / (1 + np.exp(-sums[k // 2]))
                back = back * sigmoid * (1 + sums[k // 2] * (1 - sigmoid))
            slopes, back = (layers[k // 2].T @ back, back.sum(0)), back @ weights[k].T
            for n, slope in zip((k, k + 1), slopes, strict=True):
                first[n] += 0.1 * (slope - first[n])
                second[n] += 0.001 * (slope**2 - second[n])
                mean, size = first[n] / (1 - 0.9**step), second[n] / (1 - 0.999**step)
                weights[n] = weights[n] - slow * (mean / (np.sqrt(size) + 1e-8)).astype("f4")
        if step % 1000 == 0:
            error = np.abs(forward(weights, x[:4096]) - y[:4096]).mean()
            print(f"step {step}: mean absolute error {error:.3f} standard deviations", flush=True)
    return weights


class BehaviourCloning:
    def __init__(self, *, weights: str = "bc.npz") -> None:
        with np.load(weights) as kept:
            self._kept = {name: kept[name] for name in kept.files}
        self._weights = [self._kept[f"w{k}"] for k in range(sum(name[0] == "w" for name in self._kept))]
        self.card = PolicyCard(
            name="bc-lowdim",
            control_hz=HZ,
            out_of_bounds="clip",
            trained_on=tuple(self._kept["trained_on"].tolist()),
            **CARD,
        )

    def reset(self, instruction):
        self._scrubs, self._place, self._steps, self._way_m = "scrub" in instruction, None, 0, 0.0

    def act(self, observation):
        """Return the next half second of targets."""
        tool = observation.pose_tcp_in_base
        if self._place is None:
            try:
                self._place = Place(observation)
            except PerceptionFailure:
                return Action(done=True)
            self._first, self._target = tool, tool
        x = features(self._place, tool, self._target, self._first, self._steps / HZ, self._way_m, self._scrubs)
        out = forward(self._weights, np.clip((x - self._kept["mean_x"]) / self._kept["std_x"], -5, 5))
        out = out * self._kept["std_y"] + self._kept["mean_y"]
        start, ends = self._target, out[-1] * CHUNK <= EXECUTED and self._steps > 5 * HZ
        wanted = targets(start, out, self._place.axes)
        self._target, self._steps = wanted[-1], self._steps + EXECUTED
        self._way_m += travelled(wanted, start)[-1]
        return [Action(pose_tcp_in_base=pose, done=bool(ends and pose is wanted[-1])) for pose in wanted]


def main():
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("demonstrations", nargs="+", help="folders of carecontact demonstrate")
    parser.add_argument("--out", default="bc.npz")
    parser.add_argument("--jobs", type=int, help="processes that read recordings; by default one per core")
    given = parser.parse_args()
    parts = [part for part in each(windows, given.demonstrations, given.jobs) if part is not None]
    x, y = (np.concatenate([part[k] for part in parts]) for k in (0, 1))
    print(f"{len(parts)} demonstrations, {len(x)} steps", flush=True)
    scale = {"mean_x": x.mean(0), "std_x": x.std(0) + 1e-3, "mean_y": y.mean(0), "std_y": y.std(0) + 1e-3}
    began = time.process_time()
    x, y = (x - scale["mean_x"]) / scale["std_x"], (y - scale["mean_y"]) / scale["std_y"]
    weights = train(x.astype("f4"), y.astype("f4"))
    print(f"trained in {time.process_time() - began:.0f} s of CPU")
    salts = sorted({part[2] for part in parts})
    np.savez(given.out, trained_on=np.array(salts), **scale, **{f"w{k}": w for k, w in enumerate(weights)})


if __name__ == "__main__":
    main()

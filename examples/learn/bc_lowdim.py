"""Behaviour cloning on 34 numbers: from demonstrations to a policy in about a minute, with numpy alone.

    carecontact demonstrate --level L1 --persons 100 --tasks T1,T3 --out runs/demos
    python bc_lowdim.py runs/demos --out bc.npz
    carecontact run --policy bc_lowdim:BehaviourCloning --policy-arg weights=bc.npz \\
        --protocol bathing-wide-v2-draft --level L1 --tasks T1,T3 --seeds 0-8 --out runs/bc

The last command, with --control shuffled-look behind it, shows what the policy owes to its one look.

The policy looks once, with the arm out of the way, and reads three joints and nine points of the skin along the forearm
from the picture. They give a frame on the forearm. In it stand the tool, its last target, and how far the tool lags
behind: the hand feels through this lag. A network of three layers maps these numbers to the next second of targets.
"""

import argparse
import time
from itertools import pairwise

import numpy as np

from carecontact.interface.action import Action
from carecontact.interface.geometry import matrix_from_quat, matrix_from_vector, quat_from_matrix, vector_from_matrix
from carecontact.interface.policy import PolicyCard

HZ, CHUNK, EXECUTED = 20, 20, 10  # targets in a second, targets that the network gives, and those that are executed
SHOULDER, ELBOW, WRIST = 12, 14, 16  # MediaPipe Pose, the right side
CARD = {"modalities": ("depth", "landmarks"), "cameras": ("overhead",), "camera_hz": {"overhead": 0.0}}


def look(view):
    """Return shoulder, elbow and wrist (3, 3) and nine points (9, 3) of the skin from elbow to wrist, in base [m]; None
    where the person is not found."""
    joints = np.asarray(view.landmarks_in_base, float)[[SHOULDER, ELBOW, WRIST]]
    if not np.isfinite(joints).all():
        return None
    points, to_camera = [], np.linalg.inv(view.pose_camera_in_base)
    for share in np.linspace(0.1, 0.9, 9):
        at = to_camera @ np.append(joints[1] + share * (joints[2] - joints[1]), 1.0)
        u, v = (view.intrinsics @ at[:3])[:2] / at[2]
        row, column = round(v), round(u)
        depth = np.nanmedian(view.depth[max(row - 2, 0) : row + 3, max(column - 2, 0) : column + 3])
        ray = np.linalg.inv(view.intrinsics) @ [u, v, 1.0]
        points.append((view.pose_camera_in_base @ np.append(depth * ray, 1.0))[:3])
    return (joints, np.array(points)) if np.isfinite(points).all() else None


class Forearm:
    """The frame of a forearm as it was seen: x from elbow to wrist along the bed, z up, the origin on the skin."""

    def __init__(self, joints, points):
        way, share = points[-1] - points[0], np.linspace(-0.4, 0.4, 9)
        slope, height = np.polyfit(share, points[:, 2], 1)
        yaw = np.arctan2(way[1], way[0])
        cos, sin = np.cos(yaw), np.sin(yaw)
        self.axes = np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])
        self.origin = np.append(np.median(points[2:7, :2], axis=0), height)
        bend = 10 * (points[:, 2] - height - slope * share)
        shape = [cos, sin, np.hypot(way[0], way[1]), slope]
        self.numbers = np.concatenate([shape, bend, self.at(joints[0]), self.axes @ -self.origin])

    def at(self, place):
        return self.axes @ (place - self.origin)


def features(arm, tool, target, first, time_s, scrubs):
    """(34,) numbers. ``tool``, ``target``, ``first``: (7,) the tool, its last target, and where it was at first."""
    turned = turn(first, target)
    at, goal = arm.at(tool[:3]), arm.at(target[:3])
    clock = [time_s / 10, min(time_s, 3.0), float(scrubs)]
    return np.concatenate([at, goal, 10 * (goal - at), turned, arm.numbers, clock])


def turn(start, end):
    """(3,) rotation vector along the axes of the base from one pose to another."""
    return vector_from_matrix(matrix_from_quat(end[3:]) @ matrix_from_quat(start[3:]).T)


def windows(folder, trial):
    """Return the features (N, 34) and the following second (N, 121) of every step of a demonstration; None where the
    person is not found."""
    from carecontact.interface.geometry import pose_matrix
    from carecontact.recording import read_recording
    from carecontact.replay.observations import Resensed

    recording = read_recording(folder / f"{trial}.h5")
    seen = next(Resensed(recording, PolicyCard(name="look", **CARD)).observations(HZ))
    found = look(seen.cameras["overhead"])
    if found is None:
        return None
    arm, base = Forearm(*found), recording.header.pose_base_in_world
    to_base = np.linalg.inv(pose_matrix(np.array(base[:3]), np.array(base[3:])))
    at = np.searchsorted(recording["scorer/time_s"], recording["actions/time_s"] - 1e-9)
    poses = [to_base @ pose_matrix(p[:3], p[3:]) for p in recording["scorer/pose_tcp_in_world"][at].astype(float)]
    tools = [np.append(pose[:3, 3], quat_from_matrix(pose[:3, :3])) for pose in poses]
    given = held(recording["actions/pose_tcp_in_base"], tools[0])
    wanted = held(recording["actions/demonstrated"][:, :7], tools[0]) if "actions/demonstrated" in recording else given
    x, y, count = [], [], len(given)
    for k in range(count):
        last = given[k - 1] if k else tools[0]
        ahead = wanted[np.minimum(np.arange(k, k + CHUNK), count - 1)]
        places = (ahead[:, :3] - last[:3]) @ arm.axes.T
        turns = [turn(last, pose) for pose in ahead]
        x.append(features(arm, tools[k], last, tools[0], k / HZ, recording.header.spec.task_id == "T3"))
        y.append(np.concatenate([10 * places.ravel(), np.ravel(turns), [min((count - k) / CHUNK, 2.0)]]))
    return np.array(x), np.array(y), recording.header.spec.commitment


def held(poses, before):
    """(N, 7) targets, each the one before where an action kept it."""
    out = np.vstack([before, poses])
    for k in range(1, len(out)):
        out[k] = out[k - 1] if np.isnan(out[k, 0]) else out[k]
    return out[1:]


def forward(weights, x):
    for k in range(0, len(weights), 2):
        x = x @ weights[k] + weights[k + 1]
        if k + 2 < len(weights):
            x = x / (1 + np.exp(-x))
    return x


def train(x, y, *, width=192, steps=5000, batch=512, rate=2e-3, seed=0):
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
        self._scrubs, self._arm, self._steps = "scrub" in instruction, None, 0

    def act(self, observation):
        """Return the next half second of targets."""
        tool = observation.pose_tcp_in_base
        if self._arm is None:
            found = look(observation.cameras["overhead"])
            if found is None:
                return Action(done=True)
            self._arm, self._first, self._target = Forearm(*found), tool, tool
        x = features(self._arm, tool, self._target, self._first, self._steps / HZ, self._scrubs)
        out = forward(self._weights, (x - self._kept["mean_x"]) / self._kept["std_x"])
        out = out * self._kept["std_y"] + self._kept["mean_y"]
        places, turns = out[: 3 * CHUNK].reshape(-1, 3) / 10, out[3 * CHUNK : 6 * CHUNK].reshape(-1, 3)
        start, ends = self._target, out[-1] * CHUNK <= EXECUTED and self._steps > 5 * HZ
        actions = []
        for place, vector in list(zip(places, turns, strict=True))[:EXECUTED]:
            quat = quat_from_matrix(matrix_from_vector(vector) @ matrix_from_quat(start[3:]))
            self._target = np.concatenate([start[:3] + self._arm.axes.T @ place, quat])
            self._steps += 1
            actions.append(Action(pose_tcp_in_base=self._target, done=bool(ends and len(actions) == EXECUTED - 1)))
        return actions


def main():
    from pathlib import Path

    from carecontact.runs.scoring import read_scores

    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("demonstrations", type=Path, nargs="+", help="folders of carecontact demonstrate")
    parser.add_argument("--out", type=Path, default=Path("bc.npz"))
    given = parser.parse_args()
    parts, salts = [], set()
    for folder in given.demonstrations:
        for score in read_scores(folder).scores:
            if score.safety_gated and (part := windows(folder, score.trial_id)) is not None:
                parts.append(part[:2])
                salts.add(part[2])
    x, y = (np.concatenate(each) for each in zip(*parts, strict=True))
    print(f"{len(parts)} demonstrations, {len(x)} steps", flush=True)
    scale = {"mean_x": x.mean(0), "std_x": x.std(0) + 1e-3, "mean_y": y.mean(0), "std_y": y.std(0) + 1e-3}
    began = time.process_time()
    x, y = (x - scale["mean_x"]) / scale["std_x"], (y - scale["mean_y"]) / scale["std_y"]
    weights = train(x.astype("f4"), y.astype("f4"))
    print(f"trained in {time.process_time() - began:.0f} s of CPU")
    np.savez(given.out, trained_on=np.array(sorted(salts)), **scale, **{f"w{k}": w for k, w in enumerate(weights)})


if __name__ == "__main__":
    main()

"""A policy from point clouds by flow matching, in PyTorch: trained in minutes on one GPU, it looks twice a second.

    carecontact demonstrate --protocol bathing-wide-v2 --persons 200 --noise 4mm --tasks T1,T3 --out demos
    python point_flow.py prepare demos --out demos.npz
    python point_flow.py train demos.npz --out point_flow.pt
    carecontact run --policy point_flow:PointFlow --policy-arg weights=point_flow.pt \\
        --protocol bathing-wide-v2 --level L1 --tasks T1,T3 --seeds 0-8 --out point_flow

It knows no body and no foam: what it sees are coloured points of the first picture, in which the arm is out of the way,
and of the last one. All places are relative to the last target of the tool, and persons are turned about the robot's
base while it trains, so that only what is near the hand and how it lies has to be learned. A network encodes points and
hand, and another one carries noise to the next second of targets along a learned velocity (Lipman et al. 2023, "Flow
matching for generative modeling"). The targets of the first half second are executed.
"""

import argparse
import math
import os
import time

import numpy as np
import torch
from demonstrations import HZ, SMALL_M, SMALL_RAD, demonstration, each, travelled, turn
from torch import nn

from carecontact.interface.action import Action
from carecontact.interface.geometry import matrix_from_quat, matrix_from_vector, quat_from_matrix
from carecontact.interface.policy import PolicyCard

CHUNK, EXECUTED = 20, 10  # targets that the network gives, and those that are executed
POINTS = 512  # of each of the two pictures
LOOKS_HZ = HZ / EXECUTED
CARD = {"modalities": ("rgb", "depth", "points"), "cameras": ("overhead",), "camera_hz": {"overhead": LOOKS_HZ}}
NUMBERS, VECTORS = 4, 5  # of a state, see ``state``
OUTPUTS = 6 * CHUNK + 1  # places and turns of the targets, and what is left of the motion


def cloud(view):
    """Return POINTS points (POINTS, 6) of a view, places in base [m] and colours: those that the arm might reach, and
    rather colourful ones than white linen."""
    near = np.flatnonzero((np.abs(view.points[:, 2]) < 0.5) & (np.linalg.norm(view.points, axis=1) < 1.0))
    near = np.resize(near, max(len(near), POINTS)) if len(near) else np.zeros(POINTS, int)
    colours = view.point_colors[near] / 255.0
    wanted = 0.01 + (np.ptp(colours, axis=1) / np.maximum(colours.max(1), 0.2)) ** 4
    drawn = np.argpartition(np.random.default_rng(0).exponential(size=len(near)) / wanted, POINTS - 1)[:POINTS]
    return np.hstack([view.points[near[drawn]], colours[drawn]]).astype("f4")


def state(tool, target, time_s, way_m, scrubs):
    """Return NUMBERS numbers and VECTORS vectors (VECTORS, 3) of a state: time and way of the targets since the
    beginning, and the task; place and rotation of the last target, and how far the tool lags behind it."""
    numbers = [time_s / 10, min(time_s, 3.0), way_m, float(scrubs)]
    rotation = matrix_from_quat(target[3:])
    vectors = [target[:3], 10 * (target[:3] - tool[:3]), turn(tool, target), rotation[:, 0], rotation[:, 1]]
    return np.array(numbers, "f4"), np.array(vectors, "f4")


# Preparation: from recordings to arrays.


def prepared(path):
    """Return the arrays of one demonstration: clouds (L, POINTS, 6), and for each of N targets the state before it, the
    following second (N, OUTPUTS), and the number of the last cloud."""
    shown = demonstration(path, PolicyCard(name="look", **CARD), LOOKS_HZ)
    first, count, scrubs = shown.tool[0], len(shown.given), "scrub" in shown.looks[0].instruction
    way = np.append(0.0, travelled(shown.wanted, first))
    states, chunks = [], []
    for k in range(count):
        last = shown.given[k - 1] if k else first
        ahead = shown.wanted[np.minimum(np.arange(k, k + CHUNK), count - 1)]
        states.append(state(shown.tool[k], last, k / HZ, way[k], scrubs))
        turns = np.ravel([turn(last, pose) for pose in ahead])
        chunks.append(np.concatenate([np.ravel(ahead[:, :3] - last[:3]), turns, [min((count - k) / CHUNK, 2.0)]]))
    numbers, vectors = (np.array(part) for part in zip(*states, strict=True))
    clouds = np.array([cloud(look.cameras["overhead"]) for look in shown.looks])
    seen = np.minimum(np.arange(count) // EXECUTED, len(clouds) - 1)
    arrays = {"clouds": clouds, "numbers": numbers, "vectors": vectors, "chunks": np.array(chunks, "f4"), "seen": seen}
    return arrays, shown.salt


def prepare(folders, out, jobs):
    parts, salts, clouds = [], set(), 0
    for arrays, salt in each(prepared, folders, jobs):
        parts.append({**arrays, "first": np.full(len(arrays["seen"]), clouds), "seen": arrays["seen"] + clouds})
        clouds += len(arrays["clouds"])
        salts.add(salt)
    joined = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    np.savez(out, trained_on=np.array(sorted(salts)), **joined)
    print(f"{len(parts)} demonstrations, {len(joined['seen'])} targets, {clouds} clouds")


# The networks.


class Encoder(nn.Module):
    """Points and state to a vector (512): as PointNet (Qi et al. 2017) by the largest feature, and by sixteen places.
    Each is the mean of the points that a learned weight selects, since a largest feature does not say exactly where."""

    def __init__(self):
        super().__init__()
        self.points = nn.Sequential(nn.Linear(7, 64), nn.SiLU(), nn.Linear(64, 128), nn.SiLU())
        self.feature, self.weight = nn.Linear(128, 256), nn.Linear(128, 16)
        self.joined = nn.Sequential(
            nn.Linear(256 + 48 + NUMBERS + 3 * VECTORS + 3, 512), nn.SiLU(), nn.Linear(512, 512)
        )

    def forward(self, points, numbers, vectors):
        """``points`` (B, P, 7): places relative to the last target [m], colours, and 1 for those of the last look."""
        points = points * points.new_tensor([4.0, 4.0, 4.0, 1.0, 1.0, 1.0, 1.0])
        hidden = self.points(points)
        places = torch.einsum("bpk,bpc->bkc", self.weight(hidden).softmax(1), points[..., :3])
        lag = torch.asinh(vectors[:, 1] / (10 * SMALL_M))
        parts = self.feature(hidden).amax(1), places.flatten(1), numbers, vectors.flatten(1), lag
        return self.joined(torch.cat(parts, 1))


class Flow(nn.Module):
    """The velocity (OUTPUTS) at a place and time between noise and targets, under what the encoder saw."""

    def __init__(self, blocks=3, width=512):
        super().__init__()
        self.encoder, self.into = Encoder(), nn.Linear(OUTPUTS + 16 + 512, width)
        self.blocks = nn.ModuleList(
            nn.Sequential(nn.LayerNorm(width), nn.Linear(width, width), nn.SiLU(), nn.Linear(width, width))
            for _ in range(blocks)
        )
        self.out = nn.Sequential(nn.LayerNorm(width), nn.Linear(width, OUTPUTS))

    def forward(self, at, time, seen):
        angles = time * (math.pi * 2.0 ** torch.arange(8, device=at.device))
        x = self.into(torch.cat([at, angles.sin(), angles.cos(), seen], 1))
        for block in self.blocks:
            x = x + block(x)
        return self.out(x)

    def sample(self, noise, seen, steps=10):
        """Return targets (B, OUTPUTS), scaled, by Euler steps from noise."""
        for k in range(steps):
            noise = noise + self(noise, torch.full_like(noise[:, :1], k / steps), seen) / steps
        return noise


def relative(first, last, vectors):
    """Return the points (B, 2 POINTS, 7) of two clouds (B, POINTS, 6), relative to the last target."""
    flags = [torch.full_like(first[..., :1], value) for value in (0.0, 1.0)]
    points = torch.cat([torch.cat([first, flags[0]], 2), torch.cat([last, flags[1]], 2)], 1)
    return torch.cat([points[..., :3] - vectors[:, None, 0], points[..., 3:]], 2)


def squashed(chunks):
    """Return chunks (B, OUTPUTS) in which differences larger than SMALL_M and SMALL_RAD count by their logarithm."""
    places, turns, left = chunks.split((3 * CHUNK, 3 * CHUNK, 1), 1)
    return torch.cat([torch.asinh(places / SMALL_M), torch.asinh(turns / SMALL_RAD), left], 1)


def stretched(chunk):
    """Return the places and the turns (CHUNK, 3) of one squashed chunk (OUTPUTS,)."""
    places, turns = np.sinh(chunk[:-1]).reshape(2, CHUNK, 3)
    return SMALL_M * places, SMALL_RAD * turns


def turned(vectors, angle):
    """Return vectors (B, V, 3) turned about z by angles (B,): the same person elsewhere around the robot's base."""
    cos, sin = angle.cos()[:, None], angle.sin()[:, None]
    x, y, z = vectors.unbind(-1)
    return torch.stack([cos * x - sin * y, sin * x + cos * y, z], -1)


# Training.


def train(data, out, *, steps, batch, device, rate=1e-3):
    torch.manual_seed(0)
    torch.set_float32_matmul_precision("high")
    with np.load(data) as kept:
        salts = kept["trained_on"].tolist()
        arrays = {name: torch.as_tensor(kept[name], device=device) for name in kept.files if name != "trained_on"}
    chunks = arrays["chunks"]
    scale = squashed(chunks).square().mean(0).sqrt() + 1e-3
    flow = Flow().to(device)
    mean = torch.optim.swa_utils.AveragedModel(flow, multi_avg_fn=torch.optim.swa_utils.get_ema_multi_avg_fn(0.998))
    optimiser = torch.optim.AdamW(flow.parameters(), lr=rate, weight_decay=1e-4)
    rates = torch.optim.lr_scheduler.OneCycleLR(optimiser, rate, total_steps=steps, pct_start=0.05)
    began, losses = time.time(), []
    for step in range(1, steps + 1):
        rows = torch.randint(len(chunks), (batch,), device=device)
        angle = torch.empty(batch, device=device).uniform_(-0.5, 0.5)
        first, last = (arrays["clouds"][arrays[name][rows]] for name in ("first", "seen"))
        first, last = (torch.cat([turned(it[..., :3], angle), it[..., 3:]], 2) for it in (first, last))
        vectors = turned(arrays["vectors"][rows], angle)
        numbers = arrays["numbers"][rows] + 0.01 * torch.randn(batch, NUMBERS, device=device)
        places = turned(chunks[rows, :-1].reshape(batch, 2 * CHUNK, 3), angle).reshape(batch, -1)
        target = squashed(torch.cat([places, chunks[rows, -1:]], 1)) / scale
        noise, at = torch.randn_like(target), torch.rand(batch, 1, device=device)
        seen = flow.encoder(relative(first, last, vectors), numbers, vectors)
        velocity = flow(at * target + (1 - at) * noise, at, seen)
        loss = nn.functional.mse_loss(velocity, target - noise)
        optimiser.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(flow.parameters(), 1.0)
        optimiser.step()
        rates.step()
        mean.update_parameters(flow)
        losses.append(loss.detach())
        if step % max(steps // 20, 1) == 0:
            print(f"{time.time() - began:6.0f} s, step {step}: loss {torch.stack(losses).mean():.3f}", flush=True)
            losses = []
    weights = {name: value.half().cpu() for name, value in mean.module.state_dict().items()}
    torch.save({"weights": weights, "scale": scale.cpu(), "trained_on": salts}, out)
    print(f"{out}: {os.path.getsize(out) / 1e6:.1f} MB")


# The policy.


class PointFlow:
    def __init__(self, *, weights: str = "point_flow.pt") -> None:
        torch.set_num_threads(1)
        kept = torch.load(weights, map_location="cpu", weights_only=True)
        self._flow, self._scale = Flow().eval(), kept["scale"]
        self._flow.load_state_dict({name: value.float() for name, value in kept["weights"].items()})
        self.card = PolicyCard(
            name="point-flow", control_hz=HZ, out_of_bounds="clip", trained_on=tuple(kept["trained_on"]), **CARD
        )

    def reset(self, instruction):
        self._scrubs, self._target, self._steps, self._way_m = "scrub" in instruction, None, 0, 0.0
        self._random = torch.Generator().manual_seed(0)

    @torch.no_grad()
    def act(self, observation):
        """Return the next half second of targets."""
        tool, last = observation.pose_tcp_in_base, torch.from_numpy(cloud(observation.cameras["overhead"]))[None]
        if self._target is None:
            self._target, self._first = tool, last
        start = self._target
        numbers, vectors = state(tool, start, self._steps / HZ, self._way_m, self._scrubs)
        numbers, vectors = torch.from_numpy(numbers)[None], torch.from_numpy(vectors)[None]
        seen = self._flow.encoder(relative(self._first, last, vectors), numbers, vectors)
        noise = torch.randn(1, OUTPUTS, generator=self._random)
        out = (self._flow.sample(noise, seen)[0] * self._scale).double().numpy()
        places, turns = (part[:EXECUTED] for part in stretched(out))
        rotation = matrix_from_quat(start[3:])
        quats = [quat_from_matrix(matrix_from_vector(vector) @ rotation) for vector in turns]
        targets = [np.append(start[:3] + place, quat) for place, quat in zip(places, quats, strict=True)]
        ends = out[-1] * CHUNK <= EXECUTED and self._steps > 5 * HZ
        self._target, self._steps = targets[-1], self._steps + EXECUTED
        self._way_m += travelled(targets, start)[-1]
        return [Action(pose_tcp_in_base=target, done=bool(ends and target is targets[-1])) for target in targets]


def main():
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    commands = parser.add_subparsers(dest="command", required=True)
    one = commands.add_parser("prepare", help="make arrays of recordings")
    one.add_argument("demonstrations", nargs="+", help="folders of carecontact demonstrate")
    one.add_argument("--out", default="demos.npz")
    one.add_argument("--jobs", type=int, help="processes; by default one per core")
    two = commands.add_parser("train", help="make a policy of arrays")
    two.add_argument("data")
    two.add_argument("--out", default="point_flow.pt")
    two.add_argument("--steps", type=int, default=20_000)
    two.add_argument("--batch", type=int, default=512)
    two.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    given = parser.parse_args()
    if given.command == "prepare":
        prepare(given.demonstrations, given.out, given.jobs)
    else:
        train(given.data, given.out, steps=given.steps, batch=given.batch, device=given.device)


if __name__ == "__main__":
    main()

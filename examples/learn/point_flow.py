"""A policy from point clouds by flow matching, trained in PyTorch in minutes on one GPU.

    carecontact demonstrate --protocol bathing-wide-v2 --persons 200 --noise 4mm --tasks T1,T3 --out demos
    python point_flow.py prepare demos --out demos.npz
    python point_flow.py train demos.npz --out point_flow.npz
    carecontact run --policy learned --policy-arg weights=point_flow.npz \\
        --protocol bathing-wide-v2 --level L1 --tasks T1,T3 --seeds 0-8 --out point_flow

``carecontact.policies.point_flow`` runs the networks in a trial, and says what they see. Persons are turned about the
robot's base while they are trained on, so that only what is near the hand and how it lies has to be learned. One
network encodes points and hand, and another one carries noise to the next second of targets along a learned velocity
(Lipman et al. 2023, "Flow matching for generative modeling").
"""

import argparse
import math
import os
import time

import numpy as np
import torch
from demonstrations import demonstration, each
from torch import nn

from carecontact.policies.point_flow import (
    BLOCKS,
    CHUNK,
    EXECUTED,
    HZ,
    LOOK,
    NUMBERS,
    OUTPUTS,
    SCALES,
    SMALL_M,
    SMALL_RAD,
    VECTORS,
    cloud,
    state,
    travelled,
    turn,
)

# Preparation: from recordings to arrays.


def prepared(path):
    """Return the arrays of one demonstration: clouds (L, POINTS, 6), and for each of N targets the state before it, the
    following second (N, OUTPUTS), and the number of the last cloud."""
    shown = demonstration(path, LOOK, HZ / EXECUTED)
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
        points = points * points.new_tensor(SCALES)
        hidden = self.points(points)
        places = torch.einsum("bpk,bpc->bkc", self.weight(hidden).softmax(1), points[..., :3])
        lag = torch.asinh(vectors[:, 1] / (10 * SMALL_M))
        parts = self.feature(hidden).amax(1), places.flatten(1), numbers, vectors.flatten(1), lag
        return self.joined(torch.cat(parts, 1))


class Flow(nn.Module):
    """The velocity (OUTPUTS) at a place and time between noise and targets, under what the encoder saw."""

    def __init__(self, width=512):
        super().__init__()
        self.encoder, self.into = Encoder(), nn.Linear(OUTPUTS + 16 + 512, width)
        self.blocks = nn.ModuleList(
            nn.Sequential(nn.LayerNorm(width), nn.Linear(width, width), nn.SiLU(), nn.Linear(width, width))
            for _ in range(BLOCKS)
        )
        self.out = nn.Sequential(nn.LayerNorm(width), nn.Linear(width, OUTPUTS))

    def forward(self, at, time, seen):
        angles = time * (math.pi * 2.0 ** torch.arange(8, device=at.device))
        x = self.into(torch.cat([at, angles.sin(), angles.cos(), seen], 1))
        for block in self.blocks:
            x = x + block(x)
        return self.out(x)


def relative(first, last, vectors):
    """Return the points (B, 2 POINTS, 7) of two clouds (B, POINTS, 6), relative to the last target."""
    flags = [torch.full_like(first[..., :1], value) for value in (0.0, 1.0)]
    points = torch.cat([torch.cat([first, flags[0]], 2), torch.cat([last, flags[1]], 2)], 1)
    return torch.cat([points[..., :3] - vectors[:, None, 0], points[..., 3:]], 2)


def squashed(chunks):
    """Return chunks (B, OUTPUTS) in which differences larger than SMALL_M and SMALL_RAD count by their logarithm."""
    places, turns, left = chunks.split((3 * CHUNK, 3 * CHUNK, 1), 1)
    return torch.cat([torch.asinh(places / SMALL_M), torch.asinh(turns / SMALL_RAD), left], 1)


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
    weights = {name: value.half().cpu().numpy() for name, value in mean.module.state_dict().items()}
    np.savez_compressed(out, scale=scale.cpu().numpy(), trained_on=np.array(salts), **weights)
    print(f"{out}: {os.path.getsize(out) / 1e6:.1f} MB")


def main():
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    commands = parser.add_subparsers(dest="command", required=True)
    one = commands.add_parser("prepare", help="make arrays of recordings")
    one.add_argument("demonstrations", nargs="+", help="folders of carecontact demonstrate")
    one.add_argument("--out", default="demos.npz")
    one.add_argument("--jobs", type=int, help="processes; by default one per core")
    two = commands.add_parser("train", help="make a policy of arrays")
    two.add_argument("data")
    two.add_argument("--out", default="point_flow.npz")
    two.add_argument("--steps", type=int, default=52_000)
    two.add_argument("--batch", type=int, default=512)
    two.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    given = parser.parse_args()
    if given.command == "prepare":
        prepare(given.demonstrations, given.out, given.jobs)
    else:
        train(given.data, given.out, steps=given.steps, batch=given.batch, device=given.device)


if __name__ == "__main__":
    main()

"""Make indentation trials whose law is known, by another route than the one that calibration fits with.

    python tools/make_synthetic_trials.py forearm --route fine-mesh --out trials.csv --truth truth.json
    python tools/make_synthetic_trials.py abdomen --route analytic --material nearly-linear --loss area --out trials.csv

Two routes:
  analytic   F = k d^n + loss, or k (exp(d / delta) - 1) + loss (--material exponential), no simulation at all. The
             loss is beta v times the first term (--loss force; Hunt and Crossley 1975), eta A(d) v with the
             indenter's area in contact (--loss area) or zeta d v (--loss depth); all lose about the same work;
  fine-mesh  the region's shell with vertices half as far apart, stepped at half the time step; a drawn law, every
             subject stiffer or softer by a few percent, every press a little beside the place that the file records.
Both add what a recording has: indentation counted from a wrong zero, sensor noise, an offset and a drift of the force,
noise of the position, and free motion before touch. The seed is drawn unless given and is written to ``--truth``
alone, never into the trials.
"""

from __future__ import annotations

import argparse
import json
import secrets
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from carecontact.human.library import load_body
from carecontact.protocol.load import load_protocol
from carecontact.protocol.person import Tissue
from carecontact.sim.bench import Bench, Indenter

HEADER = (
    "trial_id,site,subject,t_s,indentation_mm,force_N,phase,speed_mm_s,indenter_shape,indenter_size_mm,preload_N,"
    "filter,along_mm,across_mm,tilt_deg"
)
SUBJECTS = 3
FREE_MM = 1.5
TURN_MM_S2 = 1000.0
"""Deceleration and acceleration at the turn."""
SAMPLES = 130
"""Per trial, at most about."""


@dataclass(frozen=True, kw_only=True)
class Setup:
    indenter: Indenter
    depth_mm: float
    places_mm: tuple[tuple[float, float], ...]
    speeds_mm_s: tuple[float, ...]
    analytic_speeds_mm_s: tuple[float, ...]
    """Where beta v stays below 0.2."""
    k_n: tuple[float, float]
    """Range of the force at full depth for the analytic route [N]."""
    beta_s_m: tuple[float, float]
    """Its loss."""

    def cells(self, route: str) -> Iterator[tuple[str, tuple[float, float], float]]:
        """Subject, place and speed of every press: each speed at each place, subjects in turn."""
        speeds = self.analytic_speeds_mm_s if route == "analytic" else self.speeds_mm_s
        for number, (speed, place) in enumerate((s, p) for s in speeds for p in self.places_mm):
            yield f"synthetic-{number % SUBJECTS + 1}", place, speed


EXPONENTS = {"nearly-linear": (1.05, 1.25), "middling": (1.35, 1.75), "stiffening": (1.75, 2.25)}
"""Range of the exponent n for each material of the analytic route whose force is a power of the depth."""
EXPONENTIAL, DELTAS = "exponential", (1.0, 2.5)
"""The material that is not, and how many times its delta goes into the full depth: its tangent grows by e to 12 times.
Neither form nor range is fitted to anything."""
LOSSES = ("force", "area", "depth")
RIM_MM = 0.3
"""Depth over which a disc comes to lie on the skin."""
SETUPS = {
    "forearm": Setup(
        indenter=Indenter(shape="flat", size_m=0.0107), depth_mm=4.5, speeds_mm_s=(3.0, 10.0, 25.0),
        analytic_speeds_mm_s=(3.0, 10.0, 25.0),
        places_mm=((-20.0, -4.0), (0.0, 0.0), (20.0, 4.0)), k_n=(3.5, 7.0), beta_s_m=(4.0, 8.0),
    ),
    "abdomen": Setup(
        indenter=Indenter(shape="hemisphere", size_m=0.010), depth_mm=15.0, speeds_mm_s=(10.0, 25.0, 50.0),
        analytic_speeds_mm_s=(5.0, 10.0, 25.0),
        places_mm=((-25.0, 20.0), (0.0, 0.0), (25.0, -15.0)), k_n=(4.0, 8.0), beta_s_m=(4.0, 8.0),
    ),
}  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Noise:
    force_n: float = 0.02
    offset_n: float = 0.10
    drift_n_s: float = 0.02
    position_mm: float = 0.01
    zero_mm: float = 0.15
    location_mm: float = 1.5
    stiffness_share: float = 0.03
    damping_share: float = 0.05


@dataclass(frozen=True, kw_only=True)
class Press:
    """True motion and force, from before touch to after release."""

    time_s: np.ndarray
    depth_mm: np.ndarray
    force_n: np.ndarray
    unload: np.ndarray


def motion(depth_mm: float, speed_mm_s: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Time, depth (negative before touch) and speed, evenly sampled; in, turned round at TURN_MM_S2, and out."""
    brake = speed_mm_s / TURN_MM_S2
    way = (depth_mm + FREE_MM - speed_mm_s * brake / 2) / speed_mm_s + brake
    rate = min(1000.0, max(50.0, SAMPLES / (2 * way)))
    time = np.arange(0.0, 2 * way, 1 / rate)
    to_turn = np.abs(time - way)
    lost = np.where(to_turn < brake, TURN_MM_S2 / 2 * to_turn**2, speed_mm_s * (to_turn - brake / 2))
    speed = np.clip(TURN_MM_S2 * (way - time), -speed_mm_s, speed_mm_s)
    return time, depth_mm - lost, speed


@dataclass(frozen=True, kw_only=True)
class Analytic:
    """The force that the module says."""

    k_n: float
    """[N mm^-n], and of an exponential [N]"""
    n: float
    """0 for an exponential."""
    delta_mm: float
    """0 for a power."""
    beta_s_m: float = 0.0
    eta_ns_m3: float = 0.0
    zeta_ns_m2: float = 0.0

    @classmethod
    def drawn(cls, region: str, rng: np.random.Generator, *, material: str, loss: str) -> Analytic:
        setup = SETUPS[region]
        shape, beta = float(rng.uniform(*EXPONENTS.get(material, DELTAS))), float(rng.uniform(*setup.beta_s_m))
        n, delta = (0.0, setup.depth_mm / shape) if material == EXPONENTIAL else (shape, 0.0)
        unit = cls(k_n=1.0, n=n, delta_mm=delta)
        law = replace(unit, k_n=float(rng.uniform(*setup.k_n)) / float(unit.elastic_n(setup.depth_mm)))
        if loss == "force":
            return replace(law, beta_s_m=beta)
        depth = np.linspace(0.0, setup.depth_mm, 500)
        same = beta * np.mean(law.elastic_n(depth))
        if loss == "depth":
            return replace(law, zeta_ns_m2=float(same / np.mean(depth / 1000)))
        return replace(law, eta_ns_m3=float(same / np.mean(area_m2(setup.indenter, depth))))

    def elastic_n(self, depth_mm: np.ndarray | float) -> np.ndarray:
        return self.k_n * (np.expm1(depth_mm / self.delta_mm) if self.delta_mm else np.asarray(depth_mm) ** self.n)

    def force_n(self, indenter: Indenter, depth_mm: np.ndarray, speed_mm_s: np.ndarray | float) -> np.ndarray:
        """Never below zero: nothing pulls the indenter."""
        d, v = np.maximum(depth_mm, 0.0), np.asarray(speed_mm_s) / 1000
        lost = self.eta_ns_m3 * area_m2(indenter, d) + self.zeta_ns_m2 * d / 1000
        return np.maximum(self.elastic_n(d) * (1 + self.beta_s_m * v) + lost * v, 0.0)


def area_m2(indenter: Indenter, depth_mm: np.ndarray) -> np.ndarray:
    """In contact, at a depth."""
    size, depth = indenter.size_m or 0.0, depth_mm / 1000
    if indenter.shape == "hemisphere":
        deep = np.minimum(depth, size)
        return np.pi * (2 * size * deep - deep**2)
    return np.pi * size**2 * (1 - np.exp(-depth_mm / RIM_MM))


def analytic(
    region: str, rng: np.random.Generator, *, material: str = "middling", loss: str = "force"
) -> tuple[dict[str, float], Iterator[tuple[str, Press]]]:
    """Truth (the fields of Analytic) and presses."""
    setup, truth = SETUPS[region], Analytic.drawn(region, rng, material=material, loss=loss)

    def presses() -> Iterator[tuple[str, Press]]:
        for subject, _, speed in setup.cells("analytic"):
            factor = subject_factor(subject, rng)
            time, depth, v = motion(setup.depth_mm * float(rng.uniform(0.98, 1.02)), speed)
            force = factor * truth.force_n(setup.indenter, depth, v)
            yield subject, Press(time_s=time, depth_mm=depth, force_n=force, unload=v < 0)

    return asdict(truth), presses()


def drawn_law(tissue: Tissue, depth_mm: float, rng: np.random.Generator) -> Tissue:
    """Another stiffness, curvature (the cubic's share at full depth) and loss than the shipped row's."""
    a = tissue.a_n_m3 * rng.uniform(0.75, 1.5)
    share, loss = rng.uniform(0.1, 0.6), rng.uniform(0.4, 1.2)
    return tissue.model_copy(
        update={
            "a_n_m3": a,
            "b_n_m4": 0.0,
            "c_n_m5": a * share / (depth_mm / 1000) ** 2,
            "damping_ns_m3": tissue.damping_ns_m3 / tissue.a_n_m3 * a * loss,
        }
    )


def simulated(
    region: str, rng: np.random.Generator, *, mesh: float = 0.5, noise: Noise | None = None, body: str = "man-adult"
) -> tuple[dict[str, float], Iterator[tuple[str, Press]]]:
    """Truth (the drawn law) and presses on a shell of ``mesh`` times the shipped spacing, at that share of 1 ms."""
    noise = noise or Noise()
    setup, base = SETUPS[region], load_protocol("bathing-v3").person.tissue[region]
    law = drawn_law(base, setup.depth_mm, rng)
    finer = {name: mesh * getattr(law, name) for name in ("spacing_m", "coarse_spacing_m")}
    law = law.model_copy(update=finer)
    bench = Bench(body=load_body(body), region=region, tissue=law, indenter=setup.indenter, dt_s=0.001 * mesh)

    def presses() -> Iterator[tuple[str, Press]]:
        drawn = rng.normal(size=(SUBJECTS, 2))
        drawn -= drawn.mean(0)  # the truth is the mean subject's
        own = {f"synthetic-{k}": row for k, row in enumerate(drawn, 1)}
        for subject, (x, y), speed in setup.cells("fine-mesh"):
            stiff, lossy = np.exp(own[subject] * [noise.stiffness_share, noise.damping_share])
            scale = {name: getattr(law, name) * stiff for name in ("a_n_m3", "b_n_m4", "c_n_m5")}
            bench.set_law(law.model_copy(update={**scale, "damping_ns_m3": law.damping_ns_m3 * stiff * lossy}))
            dx, dy = rng.normal(size=2) * noise.location_mm
            depth = setup.depth_mm * float(rng.uniform(0.98, 1.02))
            time, path, v = motion(depth, speed)
            made = bench.follow(time, path / 1000, along_m=(x + dx) / 1000, across_m=(y + dy) / 1000)
            force = np.interp(time - FREE_MM / speed, made.time_s, made.force_n, left=0.0)
            yield subject, Press(time_s=time, depth_mm=path, force_n=force, unload=v < 0)

    return {name: getattr(law, name) for name in ("a_n_m3", "b_n_m4", "c_n_m5", "damping_ns_m3")}, presses()


def subject_factor(subject: str, rng: np.random.Generator, share: float = Noise().stiffness_share) -> float:
    """The analytic route varies from press to press, as its presses have no places of their own."""
    return float(np.exp(rng.normal() * share))


def write_trials(
    path: Path,
    region: str,
    route: str,
    presses: Iterator[tuple[str, Press]],
    rng: np.random.Generator,
    noise: Noise,
) -> None:
    """The CSV file: what sensors would have recorded of the presses."""
    setup = SETUPS[region]
    size = 1000 * (setup.indenter.size_m or 0.0)
    with path.open("w", encoding="utf-8") as file:
        file.write("# SYNTHETIC trials, made by tools/make_synthetic_trials.py: not measured on anything.\n")
        file.write(HEADER + "\n")
        for number, ((subject, press), (_, place, speed)) in enumerate(
            zip(presses, setup.cells(route), strict=True), 1
        ):
            count = len(press.time_s)
            drift = rng.normal() * noise.drift_n_s * press.time_s + rng.normal() * noise.offset_n
            force = press.force_n + drift + rng.normal(size=count) * noise.force_n
            depth = press.depth_mm + rng.normal() * noise.zero_mm + rng.normal(size=count) * noise.position_mm
            for t, d, f, out in zip(press.time_s, depth, force, press.unload, strict=True):
                file.write(
                    f"s{number:02d},{region} synthetic,{subject},{t:.4f},{d:.4f},{f:.4f},{'unload' if out else 'load'},"
                    f"{speed:g},{setup.indenter.shape},{size:g},0,none,{place[0]:g},{place[1]:g},0\n"
                )


def make(
    region: str, route: str, path: Path, *, seed: int, mesh: float = 0.5, noise: Noise | None = None,
    material: str = "middling", loss: str = "force",
) -> dict[str, object]:  # fmt: skip
    """Write the trials; returns the truth. Material and loss are those of the analytic route."""
    rng, noise = np.random.default_rng(seed), noise or Noise()
    if route == "analytic":
        truth, presses = analytic(region, rng, material=material, loss=loss)
    else:
        truth, presses = simulated(region, rng, mesh=mesh, noise=noise)
    write_trials(path, region, route, presses, rng, noise)
    return {"region": region, "route": route, "seed": seed, "law": truth, "noise": asdict(noise)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("region", choices=sorted(SETUPS))
    parser.add_argument("--route", choices=("analytic", "fine-mesh"), default="fine-mesh")
    parser.add_argument(
        "--material", choices=(*EXPONENTS, EXPONENTIAL), default="middling", help="of the analytic route"
    )
    parser.add_argument("--loss", choices=LOSSES, default="force", help="of the analytic route")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--truth", type=Path, help="where to write the law and the seed")
    parser.add_argument("--seed", type=int, help="default: a new one")
    arguments = parser.parse_args()
    seed = secrets.randbits(32) if arguments.seed is None else arguments.seed
    truth = make(
        arguments.region, arguments.route, arguments.out, seed=seed, material=arguments.material, loss=arguments.loss
    )
    if arguments.truth:
        arguments.truth.write_text(json.dumps(truth, indent=2) + "\n")
    print(f"{arguments.out}: {arguments.out.stat().st_size / 1000:.0f} kB, route {arguments.route}")


if __name__ == "__main__":
    main()

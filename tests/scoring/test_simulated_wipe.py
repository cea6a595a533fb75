"""Three passes of a round tool over a flat sheet, simulated, beside what a hand computes of Pasternak's foundation.

With the contact layer, whose pressure is no linear function of depth, finite differences take the hand's place.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.linalg import solve_banded
from scipy.optimize import brentq
from scipy.special import ive, k0, k1

from carecontact.protocol.person import Tissue
from carecontact.recording import Recording
from carecontact.scoring import METRICS
from carecontact.scoring.contact import find_contact
from carecontact.scoring.metrics.cells import MMHG_PA, SLID_M
from carecontact.tissue.plugin import ENTRY_M, LAYER_M, Mesh
from tests.scoring.synthetic import make_recording
from tests.tissue.sheets import SPHERE, Sheet, sheet, tissue

CELL_M, ACROSS, PERIOD_STEPS, DT_S = 0.0075, 20, 10, 0.002
WAY_M, SPEED_M_S, CLEAR_M = 0.060, 0.1, 0.004
RADIUS_M, DEPTH_M = 0.12, 0.003
"""Of the tool, and how deep it goes: so shallow that it presses straight down, as the computation has it."""
LAW = tissue(coupling_length_m=0.0078, damping_ns_m3=1e3)
"""On the shipped mesh of 5 mm, with the coupling of the shipped belly."""


@dataclass(frozen=True, kw_only=True)
class Hand:
    """A ball at a depth: outside its contact the sheet falls as K0(r / l), without a corner at the rim."""

    contact_m: float
    """Radius."""
    force_n: float

    @property
    def pressure_kpa(self) -> float:
        return self.force_n / (np.pi * self.contact_m**2) / 1000

    def swept_m2(self, slid_m: float) -> float:
        """Area over which a straight way slides at least so far: at a distance y from its middle the contact is
        2 sqrt(c^2 - y^2) long, and skin at either end of the way is slid over by less than that."""

        def length(y: float) -> float:
            chord = 2 * np.sqrt(self.contact_m**2 - y**2)
            return WAY_M + chord - 2 * slid_m if chord > slid_m else 0.0

        edge = np.sqrt(self.contact_m**2 - (slid_m / 2) ** 2)
        return 2 * quad(length, 0, edge)[0]


def by_hand(deep_m: float = DEPTH_M) -> Hand:
    """At a depth. Under the ball, the layer between skin and tool is part of the foundation: the pressure ends over a
    length of sqrt(G / k_c)."""
    length, share = LAW.coupling_length_m, LAW.contact_n_m3 / (LAW.a_n_m3 + LAW.contact_n_m3)
    end = length * np.sqrt(1 - share)

    def depth(r: float) -> float:
        return deep_m - (RADIUS_M - np.sqrt(RADIUS_M**2 - r**2))

    def indentation(r: float, c: float) -> float:
        def bowl(at: float) -> float:
            return share * (depth(at) - 2 * end**2 / RADIUS_M)

        return bowl(r) + (depth(c) - bowl(c)) * ive(0, r / end) / ive(0, c / end) * np.exp((r - c) / end)

    def corner(c: float) -> float:
        inside = (depth(c) - share * (depth(c) - 2 * end**2 / RADIUS_M)) / end * ive(1, c / end) / ive(0, c / end)
        bowl = -share * c / np.sqrt(RADIUS_M**2 - c**2)
        return bowl + inside + depth(c) / length * k1(c / length) / k0(c / length)

    c = brentq(corner, 1e-4, np.sqrt(2 * RADIUS_M * deep_m) - 1e-6)
    beside = depth(c) * length * c * k1(c / length) / k0(c / length)
    force = 2 * np.pi * LAW.a_n_m3 * (quad(lambda r: indentation(r, c) * r, 0, c)[0] + beside)
    return Hand(contact_m=c, force_n=force)


def bed() -> Mesh:
    """A sheet under a square grid of cells."""
    mesh = sheet(half_m=0.075)
    middle = mesh.places[mesh.triangles].mean(1)[:, :2]
    column = np.floor(middle / CELL_M + ACROSS / 2).astype(np.int64)
    inside = ((column >= 0) & (column < ACROSS)).all(1)
    return replace(mesh, cells=np.where(inside, column[:, 0] * ACROSS + column[:, 1], -1))


def stroke(deep_m: float = DEPTH_M, speed_m_s: float = SPEED_M_S) -> np.ndarray:
    """(n, 2) down, over the sheet, up and back."""
    down, steps = np.linspace(0.001, -deep_m, 50), round(WAY_M / speed_m_s / DT_S)
    over = np.linspace(-WAY_M / 2, WAY_M / 2, steps)
    parts = ((-WAY_M / 2, down), (over, -deep_m), (WAY_M / 2, down[::-1]), (over[::-6], CLEAR_M))
    return np.concatenate([np.stack(np.broadcast_arrays(x, z), 1) for x, z in parts])


@dataclass(frozen=True, kw_only=True)
class Wiped:
    """Three strokes."""

    area_m2: np.ndarray
    """(cells,)"""
    sums: dict[str, np.ndarray]
    """(periods, cells) of each period"""
    force_n: np.ndarray
    """(steps,)"""

    def recording(self, *, strokes: int = 3) -> Recording:
        """What a trial would record of the first strokes."""
        periods = len(self.force_n) // PERIOD_STEPS * strokes // 3
        arrays = {f"scorer/cell_{name}": rows[:periods].astype(np.float32) for name, rows in self.sums.items()}
        arrays["scorer/cell_in_region"] = np.zeros((len(self.area_m2), 3), np.float32)
        arrays["scorer/cell_area_m2"] = self.area_m2.astype(np.float32)
        force = self.force_n[: periods * PERIOD_STEPS]
        return make_recording(duration=len(force) * DT_S, normal={"right_forearm": force}, extra=arrays)


def wipe(law: Tissue, radius_m: float, stroke: np.ndarray, *, layer_m: float = 0.0, entry_m: float = 0.0) -> Wiped:
    """Wipe three times with a ball over a sheet with this law and this contact (``world.human.versions``)."""
    mesh = bed()
    edge = mesh.places[mesh.triangles]
    area = np.linalg.norm(np.cross(edge[:, 1] - edge[:, 0], edge[:, 2] - edge[:, 0]), axis=1) / 2
    world = Sheet(law, mesh, bottom_m=radius_m, type=SPHERE, size=[radius_m, 0, 0], layer_m=layer_m, entry_m=entry_m)
    path = np.concatenate([stroke] * 3)
    path = path[: len(path) // PERIOD_STEPS * PERIOD_STEPS]
    sums, force = [world.felt.cells(world.data)], []
    for part in np.split(path, len(path) // PERIOD_STEPS):
        force += [float(row["normal_n"]) for row in world.move(part)]
        sums.append(world.felt.cells(world.data))
    return Wiped(
        area_m2=np.bincount(mesh.cells[mesh.cells >= 0], area[mesh.cells >= 0], minlength=ACROSS**2),
        sums={
            name: np.diff([getattr(one, name) for one in sums], axis=0)
            for name in ("press_ns", "shear_ns", "slip_m3", "touch_m2s")
        },
        force_n=np.array(force),
    )


@pytest.fixture(scope="module")
def wiped() -> Wiped:
    return wipe(LAW, RADIUS_M, stroke())


def value(metric: str, recording: Recording) -> float:
    found = METRICS[metric].compute(find_contact(recording))
    assert found is not None
    return found


def test_coverage_is_the_strip_that_a_hand_computes(wiped: Wiped) -> None:
    for strokes in (1, 3):
        covered = value("coverage@1", wiped.recording(strokes=strokes)) * wiped.area_m2.sum()
        assert covered == pytest.approx(by_hand().swept_m2(SLID_M), rel=0.05)


def test_pressure_is_what_a_hand_computes(wiped: Wiped) -> None:
    """Over the way down and up as well, where the ball presses less."""
    deep, often = np.unique(-stroke()[:, 1], return_counts=True)
    hands = [(by_hand(d), times) for d, times in zip(deep, often, strict=True) if d > 0]
    force = sum(hand.force_n * times for hand, times in hands)
    area = sum(np.pi * hand.contact_m**2 * times for hand, times in hands)
    assert value("pressure_mean@2", wiped.recording()) == pytest.approx(force / area / 1000, rel=0.05)


def test_three_passes_at_23_mmhg_clean_the_strip_and_two_do_not(wiped: Wiped) -> None:
    assert 20 * MMHG_PA < 1000 * by_hand().pressure_kpa < 40 * MMHG_PA
    clean = value("effective_wiping@1", wiped.recording()) * wiped.area_m2.sum()
    assert clean == pytest.approx(by_hand().swept_m2(SLID_M), rel=0.05)
    assert value("effective_wiping@1", wiped.recording(strokes=2)) == 0.0


FOREARM = tissue(
    a_n_m3=2.066e6, c_n_m5=0.0, coupling_length_m=0.005, damping_ns_m3=2.99e4, contact_n_m3=5e7, membrane_n_m=175
)
"""The stiffness, coupling and damping of a shipped forearm, without the law's growth with depth."""


def by_differences(law: Tissue, radius_m: float, deep_m: float, layer_m: float, *, rings: int = 1500) -> Hand:
    """A ball at a depth by finite differences over the radius: sheet and contact layer push back, and the layer's
    stiffness grows as k (1 + (c / layer)^2) with its compression c."""
    far = 0.12
    r = (np.arange(rings) + 0.5) * far / rings
    step = far / rings
    tension = law.a_n_m3 * law.coupling_length_m**2
    depth = deep_m - (radius_m - np.sqrt(np.maximum(radius_m**2 - r**2, 0.0)))
    depth[r > 0.99 * radius_m] = -1.0
    outer, inner = (tension * (r + side * step / 2) / (r * step**2) for side in (1, -1))
    sheet_m, touched, stiff = np.zeros(rings), depth > 0, np.zeros(rings)
    for _ in range(100):
        squeezed = np.where(touched, np.maximum(depth - sheet_m, 0.0), 0.0)
        stiff = np.where(touched, law.contact_n_m3 * (1 + (squeezed / layer_m) ** 2), 0.0)
        bands = np.zeros((3, rings))
        bands[0, 1:], bands[1], bands[2, :-1] = -outer[:-1], law.a_n_m3 + stiff + outer + inner, -inner[1:]
        sheet_m = 0.5 * sheet_m + 0.5 * solve_banded((1, 1), bands, stiff * depth)
        touched = depth > sheet_m
    pressure = stiff * (depth - sheet_m) * touched
    return Hand(contact_m=float(r[touched].max(initial=0.0)), force_n=float(2 * np.pi * (pressure * r).sum() * step))


@pytest.mark.parametrize(
    ("radius_m", "deep_m", "law", "speed_m_s"), [(0.12, 0.003, LAW, 0.1), (0.03, 0.004, FOREARM, 0.02)]
)
def test_person_v2_wipes_the_strip_and_has_the_pressure_of_finite_differences(
    radius_m: float, deep_m: float, law: Tissue, speed_m_s: float
) -> None:
    """The smaller ball goes slowly, because its forearm has all of its damping, which the solution has not."""
    path = stroke(deep_m, speed_m_s)
    found = wipe(law, radius_m, path, layer_m=LAYER_M, entry_m=ENTRY_M)
    deep, often = np.unique(np.round(-path[:, 1], 7), return_counts=True)
    hands = [(by_differences(law, radius_m, d, LAYER_M), times) for d, times in zip(deep, often, strict=True) if d > 0]
    strip = value("coverage@1", found.recording()) * found.area_m2.sum()
    assert strip == pytest.approx(hands[-1][0].swept_m2(SLID_M), rel=0.04)
    force = sum(hand.force_n * times for hand, times in hands)
    area = sum(np.pi * hand.contact_m**2 * times for hand, times in hands)
    assert value("pressure_mean@2", found.recording()) == pytest.approx(force / area / 1000, rel=0.04)

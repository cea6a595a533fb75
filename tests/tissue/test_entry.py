"""The contact: a layer that stiffens, and skin that is let in and not taken in at once."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import pytest
from scipy.optimize import brentq

from carecontact.protocol.person import Tissue
from carecontact.sim.simulation import UNSOLVED_M
from carecontact.tissue.plugin import ENTRY_M, LAYER_M
from tests.tissue.sheets import BOX, CYLINDER, ELLIPSOID, Array, Sheet, sheet, tissue

STATE = int(mujoco.mjtState.mjSTATE_INTEGRATION)
PILE_M = 0.004
"""Depth over which a soft tool's surface stiffens (``PILE`` in ``c/contact.c``)."""
CAP: dict[str, Any] = {"bottom_m": 0.012, "type": ELLIPSOID, "size": [0.012, 0.019, 0.012]}
PAD: dict[str, Any] = {"bottom_m": 0.006, "type": BOX, "size": [0.015, 0.020, 0.006]}
DISC: dict[str, Any] = {"bottom_m": 0.02, "type": CYLINDER, "size": [0.011, 0.02, 0]}


def belly(**fields: float) -> Tissue:
    # So thick that nothing here locks.
    values = {"a_n_m3": 2e5, "coupling_length_m": 0.0078, "membrane_n_m": 240.0, "thickness_m": 0.1}
    return tissue(**values | {"contact_n_m3": 5e7, "damping_ns_m3": 9e3} | fields)


def dragged(tool: dict[str, Any], press_n: float, speed_m_s: float, *, entry_m: float) -> tuple[float, float]:
    """Press a tool of 1 kg on a sheet, and drag it by a stiff damper.

    Returns the most energy made until any instant and what is missing at the end, both over what was put in. The ledger
    is that of ``carecontact.lab.validation.energy``.
    """
    made = Sheet(belly(), sheet(half_m=0.06), mass_kg=1.0, ledger=True, layer_m=LAYER_M, entry_m=entry_m, **tool)
    data, dt = made.data, made.model.opt.timestep
    data.qpos[:] = [-0.03, 0.001]
    work, lost, pushed, balance = 0.0, 0.0, np.zeros(2), []
    for _ in range(round((0.3 + 0.06 / speed_m_s) / dt)):
        before = data.qvel.copy()
        wanted = speed_m_s * min(1.0, max(0.0, (data.time - 0.3) / 0.05))
        data.qfrc_applied[:] = [100 * (wanted - before[0]), -press_n]
        work += float((pushed + data.qfrc_applied) @ before) / 2 * dt
        pushed = data.qfrc_applied.copy()
        mujoco.mj_step(made.model, data)
        row = made.felt.last(data, 1)[0]
        now = float(row["damped_j"] + row["rubbed_j"])
        lost += now
        balance.append(
            float(before @ data.qvel) / 2 + float(row["stored_j"] + row["kinetic_j"]) + lost - now / 2 - work
        )
    return max(balance) / work, -balance[-1] / work


def let_in() -> tuple[Sheet, Array]:
    """Return a pad that has been dragged 9 mm deep by half of its way, and the other half, (n, 2) places x, z."""
    made = Sheet(belly(), sheet(half_m=0.06), layer_m=LAYER_M, entry_m=ENTRY_M, **PAD)
    down = np.stack([np.full(100, -0.02), np.linspace(0.0005, -0.009, 100)], 1)
    along = np.stack([np.linspace(-0.02, 0.01, 150), np.full(150, -0.009)], 1)
    made.move(np.concatenate([down, along[:75]]))
    return made, along[75:]


def allowances(made: Sheet) -> dict[float, float]:
    """Return number -> allowance [m] of the points that touch (``c/region.h``)."""
    state = made.data.plugin_state
    first = 3 + 6 * len(made.felt.places)
    rows = state[first : first + 12 * int(state[2])].reshape(-1, 12)
    return dict(zip(rows[:, 0].tolist(), rows[:, 5].tolist(), strict=True))


@pytest.mark.parametrize(("tool", "press_n", "speed_m_s"), [(CAP, 8.0, 0.3), (PAD, 6.0, 0.1)], ids=["cap", "pad"])
def test_skin_that_is_let_in_pays_for_its_energy(tool: dict[str, Any], press_n: float, speed_m_s: float) -> None:
    """The tool lies deeper than half of its thickness, so that skin arrives beside its upright wall."""
    made, _ = dragged(tool, press_n, speed_m_s, entry_m=0.0)
    assert made > 0.05, "bears all at once"
    made, missing = dragged(tool, press_n, speed_m_s, entry_m=ENTRY_M)
    assert made < 0.001
    assert missing < 0.015


def test_a_rim_that_digs_in_loses_little() -> None:
    """Where the surface turns under the skin, friction keeps its energy, and a turn of the normal is no allowance."""
    half = np.radians(20) / 2
    nose = PAD | {
        "bottom_m": float(0.015 * np.sin(2 * half) + 0.006 * np.cos(2 * half)),
        "quat": [float(np.cos(half)), 0.0, float(np.sin(half)), 0.0],
    }
    made, missing = dragged(nose, 4.0, 0.2, entry_m=ENTRY_M)
    assert made < 0.001
    assert missing < 0.021


def test_the_tool_s_way_uses_an_allowance_up_and_rest_does_not() -> None:
    made, rest = let_in()
    before = allowances(made)
    made.move(np.tile(rest[0], (200, 1)))
    stood = allowances(made)
    made.move(rest)
    moved = allowances(made)

    large = [point for point, allowed in before.items() if allowed > 0.001 and point in moved]
    assert len(large) > 20
    np.testing.assert_allclose([stood[point] for point in large], [before[point] for point in large], rtol=0.05)
    # Skin that goes round the rim meanwhile jumps a little deeper or higher.
    left = np.array([moved[point] / stood[point] for point in large])
    assert np.median(left) == pytest.approx(np.exp(-(rest[-1, 0] - rest[0, 0]) / ENTRY_M), rel=0.15)


def test_a_state_in_which_skin_is_let_in_goes_on_bit_for_bit() -> None:
    made, rest = let_in()
    assert sum(allowed != 0 for allowed in allowances(made).values()) > 10
    state = np.zeros(mujoco.mj_stateSize(made.model, STATE))
    mujoco.mj_getState(made.model, made.data, state, STATE)
    wanted = made.move(rest)

    again = Sheet(belly(), sheet(half_m=0.06), layer_m=LAYER_M, entry_m=ENTRY_M, **PAD)
    mujoco.mj_setState(again.model, again.data, state, STATE)
    assert again.move(rest).tobytes() == wanted.tobytes()
    assert again.data.plugin_state.tobytes() == made.data.plugin_state.tobytes()


@pytest.mark.parametrize("give_m3_n", [0.0, 1 / 2.5e6], ids=["rigid", "soft"])
def test_the_layer_is_stiffer_the_deeper(give_m3_n: float) -> None:
    """Under the middle of a disc on independent springs, a w = k d (1 + (d / h)^2) and w + d is the tool's depth."""
    law, deep = tissue(a_n_m3=1e6, contact_n_m3=4e6, friction=0.01), 0.004
    mesh = sheet(half_m=0.02, spacing_m=0.00125)
    made = Sheet(law, mesh, give_m3_n=give_m3_n, layer_m=LAYER_M, entry_m=ENTRY_M, **DISC)
    made.hold(deep)
    k, h = 1 / (1 / 4e6 + give_m3_n), LAYER_M + (PILE_M if give_m3_n else 0.0)
    wanted: Any = brentq(lambda w: 1e6 * w - k * (deep - w) * (1 + ((deep - w) / h) ** 2), 0, deep)
    middle = np.linalg.norm(made.felt.places, axis=1) < 0.004
    np.testing.assert_allclose(made.felt.displacement(made.data)[middle, 0], wanted, rtol=5e-3)


def test_the_energy_of_the_layer_is_the_work_done_on_it() -> None:
    """The skin hardly gives way, so that nearly all work is in the layer, twice as deep as its h."""
    law = tissue(a_n_m3=3e6, contact_n_m3=4e6, friction=0.01, damping_ns_m3=1e4, areal_mass_kg_m2=1.0)
    made = Sheet(law, sheet(half_m=0.02, spacing_m=0.0025), ledger=True, layer_m=LAYER_M, entry_m=ENTRY_M, **DISC)
    path = np.stack([np.zeros(1000), np.linspace(0.0005, -0.005, 1000)], 1)
    rows = made.move(path)
    force = rows["force_n"][:, 2]
    work = float(((force[1:] + force[:-1]) / 2 * np.diff(path[:, 1])).sum())
    assert work - rows["damped_j"].sum() - rows["rubbed_j"].sum() == pytest.approx(rows["stored_j"][-1], rel=0.01)


@pytest.mark.parametrize("entry_m", [0.0, ENTRY_M], ids=["at once", "let in"])
def test_a_vertex_that_is_not_a_number_marks_every_step_from_then_on(entry_m: float) -> None:
    made = Sheet(belly(), sheet(), layer_m=entry_m and LAYER_M, entry_m=entry_m, **CAP)
    assert made.hold(0.004, steps=5)["left_m"] <= UNSOLVED_M
    made.felt.displacement(made.data)[np.argmax(made.felt.displacement(made.data)[:, 0]), 1] = np.nan
    mujoco.mj_step(made.model, made.data, 3)
    assert (made.felt.last(made.data, 3)["left_m"] > UNSOLVED_M).all()


@pytest.mark.parametrize(
    ("numeric", "number", "value"),
    [
        *(("law", 3, 1e300), ("law", 8, np.nan), ("law", 10, np.inf)),
        *(("contact", 0, -0.001), ("contact", 1, np.nan), ("options", 2, 0.0)),
    ],
    ids=["overflow", "friction nan", "thickness inf", "layer below 0", "entry nan", "no sweep"],
)
def test_numbers_that_no_step_can_be_made_with_mark_it(numeric: str, number: int, value: float) -> None:
    made = Sheet(belly(), sheet(), layer_m=LAYER_M, entry_m=ENTRY_M, **CAP)
    made.hold(0.004, steps=5)
    made.model.numeric(f"sheet/{numeric}").data[number] = value
    mujoco.mj_step(made.model, made.data, 2)
    assert not made.felt.last(made.data, 1)["left_m"] <= UNSOLVED_M


@pytest.mark.parametrize(("half_m", "unsolved"), [(0.02, False), (0.06, True)])
def test_a_tool_over_more_points_than_the_state_has_rows_for_marks_the_step(half_m: float, unsolved: bool) -> None:
    # A row with both takes more than twice the room that the state keeps for a point.
    box: dict[str, Any] = {"bottom_m": 0.01, "type": BOX, "size": [half_m, half_m, 0.01]}
    made = Sheet(belly(), sheet(half_m=0.05), layer_m=LAYER_M, entry_m=ENTRY_M, **box)
    row = made.hold(0.002, steps=5)
    assert (row["left_m"] > UNSOLVED_M) == unsolved
    assert row["points"] > 0

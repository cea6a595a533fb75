"""The paper's tables from recordings: written, scored as a folder, aggregated, compared to the printed digits."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
import pytest

from carecontact.episode.perception import Peak
from carecontact.interface.regions import SEGMENTS
from carecontact.interface.robot import EMBODIMENTS
from carecontact.lab.validation.subject import COMFORT_ARM_DEG, DOWN, Subject, in_base, surface_point
from carecontact.protocol.load import load_protocol
from carecontact.recording.schema import Recording
from carecontact.runs.results_file import results
from carecontact.runs.scoring import RunScores
from carecontact.scoring.score import score_recording, skin_in_tool
from carecontact.sim.close_up import skin_shift
from carecontact.sim.simulation import Simulation, lengths
from carecontact.stats import fisher_exact, mann_whitney
from carecontact.world.scene import build_scene
from tests.scoring.paper_run import METHODS
from tests.scoring.synthetic import touch

N, Z2 = 140, 1.959963984540054**2
SUCCESSES = {
    "State Machine": {"T1": 20, "T2": 20, "T3": 14, "T4": 20, "T5": 5, "T6": 20, "T7": 3},
    "VoxPoser": {"T1": 20, "T2": 0, "T3": 0, "T4": 11, "T5": 0, "T6": 8, "T7": 0},
    "pi0.5": {"T1": 1, "T2": 0, "T3": 0, "T4": 0, "T5": 0, "T6": 0, "T7": 0},
}


@pytest.fixture(scope="module")
def tables() -> dict[str, dict[str, Any]]:
    """Method -> content of its results.json."""
    return {name: scored(name) for name in METHODS}


def scored(name: str) -> dict[str, Any]:
    scores = sorted(map(score_recording, METHODS[name]()), key=lambda score: score.trial_id)
    assert len(scores) == N
    return json.loads(json.dumps(results(RunScores(scores=scores, skipped={}, versions={}))))


def percent(rate: dict[str, Any]) -> str:
    low, high = rate["pc_ci95"]
    return f"{rate['pc']:.1f} ({low:.1f}, {high:.1f})"


@pytest.mark.parametrize(
    ("method", "success", "correct", "gated"),
    [
        ("State Machine", "72.9 (65.0, 79.5)", "72.9 (65.0, 79.5)", "56.4 (48.2, 64.4)"),
        ("VoxPoser", "27.9 (21.1, 35.8)", "27.9 (21.1, 35.8)", "27.9 (21.1, 35.8)"),
        ("pi0.5", "0.7 (0.1, 3.9)", "0.0 (0.0, 2.7)", "0.0 (0.0, 2.7)"),
    ],
)
def test_rates(tables: dict[str, Any], method: str, success: str, correct: str, gated: str) -> None:
    overall = tables[method]["overall"]
    assert overall["n_episodes"] == N
    assert percent({"pc": overall["pc_success"], "pc_ci95": overall["pc_success_ci95"]}) == success
    assert percent(overall["region_correct"]) == correct
    assert percent(overall["safety_gated"]) == gated


@pytest.mark.parametrize("method", METHODS)
def test_rates_of_each_task(tables: dict[str, Any], method: str) -> None:
    """Wilson's bounds are where the observed share is z standard errors of the bound away."""
    per_task = tables[method]["per_task"]
    assert {task: row["n_success"] for task, row in per_task.items()} == SUCCESSES[method]
    for row in per_task.values():
        assert row["n_episodes"] == 20
        share = row["n_success"] / 20
        for bound in (edge / 100 for edge in row["pc_success_ci95"]):
            assert (share - bound) ** 2 == pytest.approx(Z2 * bound * (1 - bound) / 20, abs=1e-12)
    if method == "State Machine":
        assert [round(x, 1) for x in per_task["T1"]["pc_success_ci95"]] == [83.9, 100.0]


def test_medians_as_they_were_constructed(tables: dict[str, Any]) -> None:
    """Constructed to come out so: this checks the pooling and the valid n, and nothing about any method."""
    found = {}
    for method, data in tables.items():
        rows = data["overall"]["medians"]
        c1, c2, c4, c5 = (rows[k] for k in sorted(rows))
        found[method] = (
            f"{c1['estimate']:.2f} {c2['estimate']:.2e} {c4['estimate']:.3f} {c5['estimate']:.2f}",
            (c1["n_valid"], c2["n_valid"], c4["n_valid"], c5["n_valid"]),
        )
    assert found == {
        "State Machine": ("19.48 -3.61e-04 0.788 3.52", (133, 20, 133, 133)),
        "VoxPoser": ("1.46 -4.07e-04 0.883 0.21", (121, 20, 135, 121)),
        "pi0.5": ("15.39 -1.37e-03 0.999 4.42", (30, 6, 136, 30)),
    }


def test_contrasts(tables: dict[str, Any]) -> None:
    ours, theirs = (tables[m]["overall"] for m in ("State Machine", "VoxPoser"))

    def pvalue(key: str) -> str:
        return f"{fisher_exact(ours[key]['n'], N, theirs[key]['n'], N).pvalue:.2e}"

    assert pvalue("region_correct") == "4.74e-14"
    assert pvalue("safety_gated") == "1.99e-06"
    # The paper prints 5.72e-40 and 4.75e-40, which rest on every value and not on counts: here the two are constructed
    # and lie apart altogether, so only that the test sees it can be checked.
    for key in ("c1_peak_force_n", "c5_force_sd_n"):
        values = [[t[key] for t in tables[m]["trials"] if t[key] is not None] for m in ("State Machine", "VoxPoser")]
        assert mann_whitney(*values).pvalue < 1e-39


def test_gate_sweep(tables: dict[str, Any]) -> None:
    rows = {row["gamma"]: row for row in tables["State Machine"]["sweeps"]["gamma"]}
    counts = {gamma: rows[gamma]["safety_gated"] for gamma in (0.20, 0.35, 0.70, 1.00)}
    assert counts == {0.20: 49, 0.35: 79, 0.70: 100, 1.00: 101}
    assert [f"{rows[g]['pc']:.1f}" for g in counts] == ["35.0", "56.4", "71.4", "72.1"]
    for method, everywhere in (("VoxPoser", 39), ("pi0.5", 0)):
        assert {row["safety_gated"] for row in tables[method]["sweeps"]["gamma"]} == {everywhere}


@pytest.mark.parametrize("method", METHODS)
def test_other_sweeps_pass_through_the_headline(tables: dict[str, Any], method: str) -> None:
    overall, sweeps = tables[method]["overall"], tables[method]["sweeps"]
    own = {"floor_n": 0.5, "push_force_n": 3.0, "push_wrist_m": 0.02, "scrub_stroke_m": 0.1, "scrub_extent_m": 0.05}
    for gate, value in own.items():
        row = next(row for row in sweeps[gate] if row["value"] == value)
        assert row["success"] == overall["n_success"]
        assert row["region_correct"] == overall["region_correct"]["n"]
        assert row["safety_gated"] == overall["safety_gated"]["n"]


def test_exceedances(tables: dict[str, Any]) -> None:
    found = tables["State Machine"]["overall"]["exceedances"]
    assert (found["gate"]["n"], found["gate"]["n_success"]) == (36, 23)
    assert found["pain"]["n_success"] == 102 - 101
    assert tables["State Machine"]["overall"]["quadrants"] == {
        "safe_success": 79,
        "unsafe_success": 23,
        "safe_failure": 18,
        "unsafe_failure": 13,
        "crashed": 7,
    }
    for method in ("VoxPoser", "pi0.5"):
        assert tables[method]["overall"]["exceedances"]["gate"]["n"] == 0


ANATOMY = {  # target, off-target, none, process failure, C3
    "State Machine": {"forearm": (57, 0, 0, 3, 54), "upper_arm": (37, 0, 0, 3, 25), "abdomen": (39, 0, 0, 1, 23)},
    "VoxPoser": {"forearm": (57, 0, 2, 1, 20), "upper_arm": (34, 0, 3, 3, 11), "abdomen": (30, 0, 9, 1, 8)},
    "pi0.5": {"forearm": (0, 19, 40, 1, 1), "upper_arm": (0, 6, 32, 2, 0), "abdomen": (0, 5, 34, 1, 0)},
}


@pytest.mark.parametrize("method", METHODS)
def test_anatomy(tables: dict[str, Any], method: str) -> None:
    found = {}
    for region, row in tables[method]["per_region"].items():
        counts = [row["anatomy"].get(kind, 0) for kind in ("target", "off_target", "none", "process_failure")]
        found[region] = (*counts, row["n_success"])
        assert sum(counts) == row["n_episodes"] == (60 if region == "forearm" else 40)
    assert found == ANATOMY[method]


@pytest.mark.parametrize(("method", "failures"), [("State Machine", 38), ("VoxPoser", 101), ("pi0.5", 140)])
def test_every_failure_has_a_mode(tables: dict[str, Any], method: str, failures: int) -> None:
    overall = tables[method]["overall"]
    assert sum(overall["failure_modes"].values()) == sum(overall["attributions"].values()) == failures
    assert failures == N - overall["region_correct"]["n"]


def test_dominant_failures(tables: dict[str, Any]) -> None:
    assert tables["VoxPoser"]["overall"]["failure_modes"] == {
        "insufficient_progress": 68,
        "no_target_contact": 14,
        "lost_contact": 14,
        "process_failure": 5,
    }
    assert tables["pi0.5"]["overall"]["failure_modes"] == {
        "no_target_contact": 106,
        "off_target_contact": 30,
        "process_failure": 4,
    }


# Skin that lies beyond the middle of the robot's tool leaves a flag in the score.


def pressed(tool: str, sunk: float) -> Recording:
    """A tool that points down, with flat skin at a depth inside it, over half of its thickness."""
    recording = touch()
    tip = EMBODIMENTS[tool].tip
    pose = np.tile([0.5, 0.1, 0.9, 0.0, 1.0, 0.0, 0.0], (len(recording["scorer/time_s"]), 1)).astype("<f4")
    height = 0.9 + sunk * tip.half_m[2]
    corners = np.array([[0.4, 0.0, height], [0.6, 0.0, height], [0.5, 0.3, height]], "<f4")
    arrays = {
        **recording.arrays,
        "scorer/pose_tcp_in_world": pose,
        "report/skin_in_world": corners,
        "report/skin_faces": np.array([[0, 1, 2]], "<i4"),
        "report/peak_time_s": np.array([0.1]),
    }
    header = recording.header.model_copy(update={"embodiment": EMBODIMENTS[tool].id})
    return replace(recording, header=header, arrays=arrays)


@pytest.mark.parametrize("tool", EMBODIMENTS)
@pytest.mark.parametrize("sunk", [-0.5, 0.4, 0.99, 1.01, 2.5])
def test_only_skin_beyond_the_tools_middle_is_flagged(tool: str, sunk: float) -> None:
    recording = pressed(tool, sunk)
    assert skin_in_tool(recording) == pytest.approx(sunk, abs=1e-4)
    assert score_recording(recording).skin_in_tool == (pytest.approx(sunk, abs=1e-4) if sunk > 1 else None)


def test_what_cannot_be_seen_is_not_flagged() -> None:
    recording = pressed("caps", 2.0)
    away = recording.arrays | {"report/skin_in_world": recording["report/skin_in_world"] + np.float32(1.0)}
    assert skin_in_tool(replace(recording, arrays=away)) is None
    bare = {name: of for name, of in recording.arrays.items() if not name.startswith("report/")}
    assert skin_in_tool(replace(recording, arrays=bare)) is None
    assert skin_in_tool(replace(recording, header=recording.header.model_copy(update={"embodiment": "other"}))) is None


@pytest.mark.parametrize("tool", ["mitt", pytest.param("caps", marks=pytest.mark.slow)])
def test_a_mitt_driven_through_the_belly_is_flagged_and_the_cap_is_not(tool: str) -> None:
    """With the skin that an episode keeps of its hardest moment: the mitt meets bone, the cap presses skin on it."""
    protocol = load_protocol("bathing-v3")
    protocol = protocol.model_copy(update={"scene": protocol.scene.model_copy(update={"tool": tool})})
    subject, impedance = Subject(protocol), protocol.impedance
    simulation = Simulation(build_scene(protocol, target="abdomen", skin=True))
    if tool == "mitt":
        # A contact layer that is linear, and skin that is not let in: the mitt goes through.
        simulation.model.numeric("abdomen/contact").data[:] = 0.0
    simulation.restore(subject.hovering("abdomen").integration_state(), comfort_arm_deg=COMFORT_ARM_DEG)
    simulation.set_stiffness(impedance.translational_bounds[1], impedance.rotational_bounds[1])
    simulation.set_goal(np.r_[in_base(simulation, surface_point(simulation, "abdomen") - [0, 0, 0.17]), DOWN], 0.8)
    peak, hardest, kept = Peak(simulation, target=SEGMENTS.index("abdomen")), 0.0, ()
    for _ in range(60):
        samples = simulation.advance(10)
        force = np.concatenate([lengths(s.force) for s in samples])
        peak.look(force)
        if force.max() > hardest:
            hardest, kept = float(force.max()), (simulation.integration_state(), simulation.time_s)
    data = mujoco.MjData(simulation.model)
    mujoco.mj_setState(simulation.model, data, kept[0], int(mujoco.mjtState.mjSTATE_INTEGRATION))
    mujoco.mj_forward(simulation.model, data)
    site = data.site("tcp")
    quat = np.zeros(4)
    mujoco.mju_mat2Quat(quat, site.xmat)
    recording = touch()
    pose = np.tile(np.r_[site.xpos, quat], (len(recording["scorer/time_s"]), 1)).astype("<f4")
    arrays = {
        **recording.arrays,
        **peak._skin(data, "abdomen", skin_shift(simulation.scene, data)),
        "scorer/pose_tcp_in_world": pose,
        "report/peak_time_s": np.array([0.1]),
    }
    header = recording.header.model_copy(update={"embodiment": EMBODIMENTS[tool].id})
    found = skin_in_tool(replace(recording, header=header, arrays=arrays))
    assert found is not None
    assert hardest > 100.0
    assert (found > 1) is (tool == "mitt")

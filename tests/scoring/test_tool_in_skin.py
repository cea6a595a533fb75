"""Skin that lies beyond the middle of the robot's tool leaves a flag in the score."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from carecontact.contract.embodiment import EMBODIMENTS
from carecontact.episode.peak import Peak
from carecontact.protocols import load_protocol
from carecontact.recording.schema import Recording
from carecontact.regions import SEGMENTS
from carecontact.reports.page.sections import caveats
from carecontact.scoring.score import score_recording
from carecontact.scoring.tool_in_skin import passed_the_middle, skin_in_tool
from carecontact.sim.close_up import skin_shift
from carecontact.sim.simulation import Simulation, lengths
from carecontact.validation.moves import DOWN, in_base, surface_point
from carecontact.validation.subject import COMFORT_ARM_DEG, Subject
from carecontact.world.scene import build_scene

from .synthetic import touch


def pressed(tool: str, sunk: float) -> Recording:
    """A tool that points down, with flat skin at a depth inside it, over half of its thickness."""
    recording = touch()
    tip = EMBODIMENTS[tool].tip
    pose = np.tile([0.5, 0.1, 0.9, 0.0, 1.0, 0.0, 0.0], (len(recording["scorer/time_s"]), 1)).astype("<f4")
    height = 0.9 + sunk * tip.half_m[2]
    corners = np.array([[0.4, 0.0, height], [0.6, 0.0, height], [0.5, 0.3, height]], "<f4")
    arrays = {
        **recording.arrays, "scorer/pose_tcp_in_world": pose, "report/skin_in_world": corners,
        "report/skin_faces": np.array([[0, 1, 2]], "<i4"), "report/peak_time_s": np.array([0.1]),
    }  # fmt: skip
    header = recording.header.model_copy(update={"embodiment": EMBODIMENTS[tool].id})
    return replace(recording, header=header, arrays=arrays)


@pytest.mark.parametrize("tool", EMBODIMENTS)
@pytest.mark.parametrize("sunk", [-0.5, 0.4, 0.99, 1.01, 2.5])
def test_only_skin_beyond_the_tools_middle_is_flagged(tool: str, sunk: float) -> None:
    recording = pressed(tool, sunk)
    assert skin_in_tool(recording) == pytest.approx(sunk, abs=1e-4)
    assert (passed_the_middle(recording) is None) is (sunk < 1)


def test_what_cannot_be_seen_is_not_flagged() -> None:
    recording = pressed("caps", 2.0)
    away = recording.arrays | {"report/skin_in_world": recording["report/skin_in_world"] + np.float32(1.0)}
    assert skin_in_tool(replace(recording, arrays=away)) is None
    bare = {name: of for name, of in recording.arrays.items() if not name.startswith("report/")}
    assert skin_in_tool(replace(recording, arrays=bare)) is None
    assert skin_in_tool(replace(recording, header=recording.header.model_copy(update={"embodiment": "other"}))) is None


def test_the_score_has_the_flag_only_where_it_is_raised() -> None:
    flagged, sound = (score_recording(pressed("mitt", sunk)) for sunk in (1.5, 0.5))
    assert flagged.skin_in_tool == pytest.approx(1.5, abs=1e-4)
    assert sound.skin_in_tool is None


@pytest.mark.parametrize("tool", EMBODIMENTS)
def test_a_mitt_driven_through_the_belly_is_flagged_and_the_cap_is_not(tool: str) -> None:
    """With the skin that an episode keeps of its hardest moment: the mitt meets bone, the cap presses skin on it."""
    protocol = load_protocol()
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
        **recording.arrays, **peak._skin(data, "abdomen", skin_shift(simulation.scene, data)),
        "scorer/pose_tcp_in_world": pose, "report/peak_time_s": np.array([0.1]),
    }  # fmt: skip
    header = recording.header.model_copy(update={"embodiment": EMBODIMENTS[tool].id})
    found = skin_in_tool(replace(recording, header=header, arrays=arrays))
    assert found is not None
    assert hardest > 100.0
    assert (found > 1) is (tool == "mitt")


def test_the_report_names_the_trial() -> None:
    score = score_recording(pressed("mitt", 1.5))
    ((title, text),) = caveats._gone_through([score, score_recording(pressed("mitt", 0.5))])
    assert title == "Tool gone through the skin"
    assert text.startswith("In 1 trial, ")
    assert score.trial_id in text
    assert caveats._gone_through([]) == []

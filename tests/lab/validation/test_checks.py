"""The check of a person who moves by itself finds what is planted in it."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import mujoco
import numpy as np
import pytest

from carecontact.human import soft_region
from carecontact.human.breathing import breath_body
from carecontact.lab.validation import alive, declared, energy, force_balance, sensitivity, stability, uniformity
from carecontact.lab.validation.alive import BREATHES, arm
from carecontact.lab.validation.alive import alive as living
from carecontact.lab.validation.convergence import MESH_REFERENCES, RADIUS_FACTORS, TREND_DEPTH_M, TRENDS
from carecontact.lab.validation.declared import declared as declared_times
from carecontact.lab.validation.declared import free_skin, free_skin_measures
from carecontact.lab.validation.energy import Energy, Ledger, bounce, drag
from carecontact.lab.validation.result import CheckResult, Measure
from carecontact.lab.validation.rig import CAP, PAD
from carecontact.lab.validation.stability import random_trial
from carecontact.lab.validation.subject import MakeScene, Scores, Subject
from carecontact.lab.validation.uniformity import curvatures, unexplained
from carecontact.protocol.load import load_protocol
from carecontact.protocol.overrides import overridden
from carecontact.protocol.protocol import Protocol
from carecontact.sim.bench import Bench
from carecontact.sim.controllers import CartesianControl
from carecontact.sim.simulation import Simulation
from carecontact.tissue.life import JOINTS
from carecontact.tissue.plugin import HELD_SIZE, LAYER_M, POINTS_EACH, add_region
from carecontact.world.scene import Scene, build_scene
from tests.lab.validation.defects import (
    ActsInContactOnly,
    PushedAtItsOrigin,
    PushedTheWrongWay,
    ReadsWrong,
    driven,
    half_damped,
    light_arm,
    lopsided_arm,
    nearly_massless,
    stiff_joints,
    without_cores,
    without_joint_limits,
)


def still_skin(protocol: Protocol, *, target: str | None, skin: bool) -> Scene:
    """The visible skin over the abdomen does not breathe."""
    scene = build_scene(protocol, target=target, skin=skin)
    model = scene.model
    # Each vertex keeps its weights, on a body that stays.
    breathes = model.skin_bonebodyid == model.body(breath_body("abdomen")).id
    assert breathes.any() == skin
    model.skin_bonebodyid[breathes] = model.body("human_abdomen").id
    return scene


def weak(protocol: Protocol, *, target: str | None, skin: bool) -> Scene:
    """The muscles of the shoulder hold with a twentieth of their stiffness."""
    scene = build_scene(protocol, target=target, skin=skin)
    scene.model.actuator(f"holds_{JOINTS[0]}").gainprm[1] /= 20
    return scene


def missed(measures: list[Measure]) -> list[str]:
    return [measure.name for measure in measures if measure.met is False]


def paralysed(protocol: Protocol, *, target: str | None, skin: bool) -> Scene:
    """Nothing drives the breath: the abdomen's servo has no force. Posed slides would move the skin all the same."""
    scene = build_scene(protocol, target=target, skin=skin)
    servo = scene.model.actuator("breathes_abdomen")
    servo.gainprm[:], servo.biasprm[:] = 0.0, 0.0
    return scene


@pytest.mark.parametrize("plant", [still_skin, pytest.param(paralysed, marks=pytest.mark.slow)])
def test_a_belly_that_does_not_breathe_is_seen_by_every_camera(subject: Subject, plant: MakeScene) -> None:
    measures = list(alive.breath_measures(living(Subject(subject.protocol, make_scene=plant)), BREATHES))
    found = {name.partition(" mm: ")[2]: name for name in missed(measures) if name.startswith("abdomen")}
    assert set(found) == {
        "visible skin of the inner area against the declared size",
        "visible skin of the whole area against the declared size",
        "depth image, median place against the declared size",
    }


def test_an_arm_that_does_not_arrive_is_found(subject: Subject) -> None:
    measures = arm(living(Subject(subject.protocol, make_scene=weak)))
    assert len(missed(measures)) == len(measures) == 2


@pytest.mark.slow
@pytest.mark.parametrize("body", ["man-adult", "man-old-heavy"])
def test_the_skin_moves_as_declared_wherever_a_tool_feels_it(body: str) -> None:
    protocol = overridden(load_protocol("bathing-v3"), {"person.body": body})
    measures = list(alive.breath_measures(living(Subject(protocol)), BREATHES))
    sizes = [m for m in measures if m.limit is not None and m.decides]
    assert len(sizes) == 7
    assert all(m.met for m in sizes), missed(sizes)
    assert max(m.value for m in sizes if "visible skin" in m.name) < 0.5


# What the convergence check holds the person against.


def layer(u: np.ndarray) -> np.ndarray:
    """Surface compliance of an incompressible layer bonded to a rigid base over that of the half space, at wave number
    u per thickness (Hayes et al. 1972)."""
    u = np.minimum(u, 300.0)
    return (np.sinh(2 * u) / 2 - u) / (u**2 + 1 + np.sinh(u) ** 2)


def flat_punch(ratio: float) -> float:
    """Force over that on a half space for radius over thickness: Fredholm's equation by Gauss quadrature."""
    x, w = np.polynomial.legendre.leggauss(24)
    t, w = (x + 1) / 2, w / 2
    u = np.linspace(1e-6, 40.0, 8001)
    rest = (1 - layer(u)) * (u[1] - u[0])
    kernel = 2 / np.pi * ratio * (np.cos(np.outer(t, u) * ratio) * rest) @ np.cos(np.outer(u, t) * ratio)
    return float(w @ np.linalg.solve(np.eye(len(t)) - kernel * w, np.ones(len(t))))


def sphere(ratio: float) -> float:
    """Force over Hertz's for sqrt(radius depth) over thickness (Dimitriadis et al. 2002, bonded, incompressible)."""
    return 1 + 1.133 * ratio + 1.283 * ratio**2 + 0.769 * ratio**3 + 0.0975 * ratio**4


def exponents(thickness_m: float) -> dict[str, float]:
    out = {}
    for name, size in TRENDS.items():
        r = size.radius_m * np.array(RADIUS_FACTORS)
        if size.shape == "flat":
            force = r * [flat_punch(float(one / thickness_m)) for one in r]
        else:
            force = np.sqrt(r) * sphere(np.sqrt(r * TREND_DEPTH_M) / thickness_m)
        out[name] = float(np.polyfit(np.log(r), np.log(force), 1)[0])
    return out


def test_both_layer_solutions_begin_alike() -> None:
    """To first order both are the half space's sinking by the image of the load: 1.133 per ratio for the sphere."""
    assert (flat_punch(0.001) - 1) / 0.001 == pytest.approx(1.133, rel=0.01)


def test_known_exponents_are_those_of_layers_fifty_to_thirty_millimetres_thick() -> None:
    thick, thin = exponents(0.050), exponents(0.030)
    layers = {name: size.layer for name, size in TRENDS.items() if size.layer is not None}
    assert layers
    for name, known in layers.items():
        assert (thick[name], thin[name]) == pytest.approx(known, abs=0.01), name


def test_meshes_are_compared_on_every_soft_region() -> None:
    assert {reference.region for reference in MESH_REFERENCES} == set(load_protocol("bathing-v3").soft_regions)


# The compiled person has what the tables declare, and what another has is named.


def test_the_shipped_person_is_as_declared(subject: Subject) -> None:
    result = declared.run(subject, quick=False)
    assert result.passed
    assert result.value("mass of the person") == pytest.approx(subject.scene("forearm").body.mass_kg)
    # Fat and muscle over the bones of arm and spine.
    assert 10 < result.value("forearm: depth of that bone, median") < 30
    assert 30 < result.value("abdomen: depth of that bone, median") < 80


@pytest.mark.parametrize(
    ("defect", "missed"),
    [
        (without_cores, {"forearm: skin with bone under it that the tool can meet"}),
        (light_arm, {"mass of a segment, largest difference"}),
        (lopsided_arm, {"centre of mass of a segment, largest distance"}),
        (stiff_joints, {"spring of a joint, largest difference", "damper of a joint, largest difference"}),
        (without_joint_limits, {"torque of an end stop, largest difference"}),
    ],
)
def test_a_person_that_is_not_as_declared_is_named(defect: MakeScene, missed: set[str]) -> None:
    result = declared.run(Subject(load_protocol("bathing-v3"), make_scene=defect), quick=True)
    assert {m.name for m in result.missed} == missed


# Inertia and damper of the skin, read from its free motion. Defects are planted in the numbers with which the compiled
# tissue computes.


@pytest.mark.parametrize("region", ["forearm", "abdomen"])
def test_a_sound_person_has_the_declared_times(subject: Subject, region: str) -> None:
    found, wanted = free_skin(subject, region), declared_times(subject, region)
    assert found.dies_s == pytest.approx(wanted.dies_s, rel=2e-3)
    assert found.returns_s == pytest.approx(wanted.returns_s, rel=2e-3)


@pytest.mark.parametrize(
    ("plant", "dies", "returns"), [(half_damped, 100.0, 50.0), (nearly_massless, 90.0, 0.0)]
)  # fmt: skip
def test_a_wrong_damper_or_inertia_is_found(
    subject: Subject, plant: Callable[[Scene], object], dies: float, returns: float
) -> None:
    found = list(free_skin_measures(ActsInContactOnly(subject, plant), "forearm"))
    assert [m.value for m in found] == pytest.approx([dies, returns], abs=0.5)
    assert [m.met for m in found] == [False, returns == 0.0]


# Energy of the person against MuJoCo's own sums and against a fall by hand.


def test_energy_differences_are_mujocos(subject: Subject) -> None:
    """Changes of potential and of kinetic energy, person only: the robot stays where it is in both states."""
    simulation = subject.at_rest("forearm")
    model, data = simulation.model, simulation.data
    rng = np.random.default_rng(3)
    robot = [model.joint(f"robot_joint{i}").dofadr[0] for i in range(1, 8)]
    data.qvel[robot] = 0.0
    energy, own, theirs = Energy(simulation), [], []
    for scale in (0.0, 1.0):
        data.qvel[energy.dof] = scale * rng.normal(0, 0.1, int(energy.dof.sum()))
        hinges = [model.joint(f"human_{name}").qposadr[0] for name in simulation.joint_names]
        data.qpos[hinges] += scale * rng.normal(0, 0.02, len(hinges))
        own.append(energy())
        mujoco.mj_energyPos(model, data)
        mujoco.mj_energyVel(model, data)
        theirs.append(data.energy.sum())
    assert theirs[1] - theirs[0] > 0.01
    assert own[1] - own[0] == pytest.approx(theirs[1] - theirs[0], rel=1e-5)


def test_lifting_the_person_stores_its_weight(subject: Subject) -> None:
    simulation = subject.at_rest("forearm")
    simulation.data.qvel[:] = 0.0
    energy = Energy(simulation)
    before = energy()
    simulation.data.qpos[simulation.model.joint("human_root").qposadr[0] + 2] += 0.1
    weight = simulation.scene.body.mass_kg * 9.81
    assert energy() - before == pytest.approx(0.1 * weight, rel=1e-5)


# The ledger of tools that touch the skin: what a wrong kernel would show, and where the energy goes.


def test_shares_are_of_what_was_put_in() -> None:
    found = Ledger(put_in=2.0, lost=0.6, balance=np.array([0.0, -0.2, 0.04, -0.1]))
    assert found.unexplained == pytest.approx(0.05)
    assert found.gain == pytest.approx(0.02)
    assert found.rise == pytest.approx(0.12)


@pytest.fixture
def linear(monkeypatch: pytest.MonkeyPatch, worlds_from_scratch: None) -> None:
    """A contact layer that does not stiffen, and skin that is not let in: a known defect."""
    monkeypatch.setattr(soft_region, "add_region", partial(add_region, layer_m=0.0, entry_m=0.0))


@pytest.mark.usefixtures("linear")
def test_energy_that_is_made_and_lost_again_counts(subject: Subject) -> None:
    """What dampers and friction take hides it from a sum of what tool and tissue hold: that only falls here."""
    found = drag(subject, "abdomen", PAD, press_n=7.0, speed_m_s=0.1, dt_s=0.002)
    assert found.gain > 0.02
    assert {m.name.rpartition(": ")[2]: m.met for m in found.measures("pad") if m.met is not None} == {
        "energy that is not accounted for, of that put in": False,
        "most energy made until any instant, of that put in": False,
    }


def test_dampers_that_drive_are_found(subject: Subject) -> None:
    """A kernel with the wrong sign on its damper books the energy that it makes as a negative loss."""
    found = bounce(ActsInContactOnly(subject, driven), "forearm", CAP, speed_m_s=0.2, dt_s=0.002)
    assert found.gain > energy.GAIN_PERCENT / 100


@pytest.mark.usefixtures("linear")
def test_contacts_beyond_the_claim_are_reported_and_do_not_decide(
    subject: Subject, monkeypatch: pytest.MonkeyPatch
) -> None:
    known = [hard for hard in energy.HARD if hard.how == "pressed with 7 N and dragged at 0.1 m/s"]
    monkeypatch.setattr(energy, "HARD", known)
    measures = list(energy.made_energy_measures(subject, "abdomen"))
    assert {m.name for m in measures if m.met is False} >= {
        "abdomen, beyond the claim: pad of 1 kg pressed with 7 N and dragged at 0.1 m/s at 2 ms: "
        "most energy made until any instant, of that put in"
    }
    assert not any(m.decides for m in measures if m.limit is not None)


def test_half_the_energy_of_a_bounce_is_somewhere_on_the_way(subject: Subject) -> None:
    """The line is not met because nothing happens: most of what the tool brings is lost in the tissue."""
    found = bounce(subject, "forearm", CAP, speed_m_s=0.2, dt_s=0.002)
    assert found.put_in == pytest.approx(0.5 * 0.2**2)
    assert 0.2 * found.put_in < found.lost < 0.95 * found.put_in
    assert abs(found.unexplained) < 0.02
    assert found.gain < 0.01


def test_a_sharp_rim_with_little_friction_makes_no_energy(subject: Subject) -> None:
    """The pad's rim is rounded with 2 mm. Where the gap beside it was no distance, dragging it gained 9 %."""
    slippery = subject.tissue("abdomen").model_copy(update={"friction": 0.01})
    found = drag(subject.with_tissue("abdomen", slippery), "abdomen", PAD, press_n=3.0, speed_m_s=0.1, dt_s=0.001)
    assert abs(found.unexplained) < 0.02
    assert found.gain < 0.01


def test_the_robot_s_own_tool_is_dragged_hard_and_pulled_slowly() -> None:
    tools = [hard.tool.name for hard in energy.of_the_layer("abdomen", energy.MITT)]
    assert tools == ["mitt", "pad", "mitt"]


# The shipped person: contact = anchors = bed = robot joint torques, as the check itself measures them; a force that is
# read the wrong way round is none of the others.


def test_joint_torques_account_for_the_dry_friction_of_the_exams_robot() -> None:
    found = force_balance.run(Subject(load_protocol("bathing-wide-v2", level="L0")), quick=True)
    torques = next(m for m in found.measures if "joint torques" in m.name)
    assert torques.value < 0.01


def test_force_balances_by_independent_paths(short_form: Callable[[str], CheckResult]) -> None:
    result = short_form("force-balance")
    assert result.missed == []
    assert result.value("forearm: largest force") > 3.0


def test_a_force_on_the_bone_with_the_wrong_sign_is_found() -> None:
    missed = {
        m.name: m.value
        for m in force_balance.run(ReadsWrong(load_protocol("bathing-v3"), rings=PushedTheWrongWay), quick=True).missed
    }
    assert missed == {
        "forearm: contact against anchors": pytest.approx(200, abs=2),
        "forearm: contact against robot joint torques": pytest.approx(200, abs=2),
        "forearm: bed reaction against weight and press": pytest.approx(200, abs=2),
    }


def test_a_bone_that_is_pushed_without_a_moment_is_found() -> None:
    missed = [
        m
        for m in force_balance.run(
            ReadsWrong(load_protocol("bathing-v3"), readings=PushedAtItsOrigin), quick=True
        ).missed
    ]
    assert [m.name for m in missed] == ["forearm: moment on the bone against the anchors' moment, over the force"]
    assert missed[0].value > 30


# What the check of sensitivity varies.


def test_the_depth_over_which_the_layer_stiffens_is_varied(subject: Subject, monkeypatch: pytest.MonkeyPatch) -> None:
    found: set[float] = set()

    def scores_of(simulation: Simulation, *_: object) -> Scores:
        found.add(float(simulation.model.numeric("forearm/contact").data[0]))
        return Scores(c1_n=1.0, c1_filtered_n=1.0, c5_n=1.0, stroke_m=1.0, beyond_measured=0.0)

    monkeypatch.setattr(sensitivity, "scores_of", scores_of)
    monkeypatch.setattr(sensitivity, "perform", lambda *_: ([], None))
    monkeypatch.setattr(sensitivity, "MOTIONS", (sensitivity.GENTLE,))
    sensitivity.run(subject, quick=False)
    assert found == {LAYER_M, LAYER_M / 2, LAYER_M * 2}


# A random trial that leaves anything in the state that is not a number is a broken one.


def first_sum_of_the_cells(simulation: Simulation, region: str) -> int:
    """The index in ``plugin_state`` of a number that nothing in a step reads."""
    felt = simulation.tissue[region]
    triangles = simulation.model.numeric(f"{region}/triangles").data.size // 5
    return felt.steps_at + 3 + 6 * len(felt.places) + HELD_SIZE * POINTS_EACH * triangles


@pytest.mark.parametrize("spoilt", [False, True])
def test_a_random_trial_is_whole_if_its_whole_state_is_finite(subject: Subject, spoilt: bool) -> None:
    simulation = subject.hovering("forearm")
    if spoilt:
        simulation.data.plugin_state[first_sum_of_the_cells(simulation, "forearm")] = np.nan
    peak, _, whole = random_trial(simulation, "forearm", np.random.default_rng(1))
    assert whole is not spoilt
    assert np.isnan(peak) == spoilt


def test_a_robot_that_is_not_held_back_fails(subject: Subject, monkeypatch: pytest.MonkeyPatch) -> None:
    """The short form passes with one that is (``test_the_protocols_person_misses_nothing_in_the_short_form``)."""
    monkeypatch.setattr(CartesianControl, "_hold_back", lambda self: None)
    missed = stability.run(subject, quick=True).missed
    assert [measure.name for measure in missed] == ["share of trials with a tool faster than 0.4 m/s"]


# What the body's curvature explains of a force.


def test_a_limb_is_round_across_and_nearly_straight_along(subject: Subject) -> None:
    shell = subject.scene("forearm").regions["forearm"].shell
    along, across = curvatures(shell, np.zeros(2))
    assert across == pytest.approx(1 / shell.radius_m, rel=0.35)
    assert abs(along) < 0.2 * across


def test_only_what_curvature_does_not_explain_is_left() -> None:
    rng = np.random.default_rng(0)
    curvature = rng.normal(size=(60, 2))
    own = rng.normal(size=60)
    force = 5.0 + curvature @ [0.3, -0.2]
    assert unexplained(force, curvature) < 1e-12
    assert unexplained(force + 0.1 * own, curvature) == pytest.approx(0.02, rel=0.3)


def test_a_spring_and_not_a_depth_is_what_a_trial_has(subject: Subject, monkeypatch: pytest.MonkeyPatch) -> None:
    """Skin whose stiffness differs from place to place by 10 %: the robot's spring of 1,000 N/m leaves half of it. Such
    places lie anyhow, so that curvature explains little of it."""
    turn = iter([0.9, 1.1] * 10)

    def press(bench: Bench, place: np.ndarray) -> np.ndarray:
        return next(turn) * 1000.0 * np.add.outer(uniformity.DEPTHS_M, (-uniformity.TANGENT_M, 0.0))

    monkeypatch.setattr(uniformity, "_press", press)
    found = {measure.name: measure for measure in uniformity.run(subject, quick=True).measures}
    at_4_mm = [measure for name, measure in found.items() if "4 mm" in name]
    spread = 100 * np.std([0.9, 1.1] * 10, ddof=1)
    assert [measure.value for measure in at_4_mm] == pytest.approx([spread, spread / 2, spread], rel=0.1)
    assert [measure.met for measure in at_4_mm] == [None, False, False]

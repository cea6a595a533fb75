from __future__ import annotations

import mujoco
import numpy as np
import pytest

from carecontact.errors import SceneError
from carecontact.human.hulls import (
    BARE_RIGID_TOOL_SOLIMP,
    BARE_SOLIMP,
    BARE_SOLREF,
    GIVES,
    RIGID_TOOL_SOLIMP,
    SOLIMP,
    SOLREF,
)
from carecontact.interface.robot import PANDA, PANDA_MITT, Tip
from carecontact.protocol.load import load_protocol
from carecontact.protocol.overrides import overridden
from carecontact.world.robot import add_robot, arrays_of, make_giving
from carecontact.world.scene import build_spec, set_physics

PROTOCOL = load_protocol("bathing-v3")


@pytest.fixture(scope="module")
def model() -> mujoco.MjModel:
    spec = mujoco.MjSpec()
    add_robot(spec, PROTOCOL)
    return spec.compile()


def parked(model: mujoco.MjModel) -> mujoco.MjData:
    data = mujoco.MjData(model)
    data.qpos[:] = PROTOCOL.scene.parked_joint_rad
    mujoco.mj_forward(model, data)
    return data


def test_flange_pose_matches_the_manufacturers_dh_table(model: mujoco.MjModel) -> None:
    # Franka control interface documentation, Denavit-Hartenberg (Craig): a, d, alpha of joints 1..7 and the flange.
    rows = [(0, 0.333, 0), (0, 0, -1), (0, 0.316, 1), (0.0825, 0, 1), (-0.0825, 0.384, -1), (0, 0, 1), (0.088, 0, 1)]
    q = np.array([0.3, -0.4, 0.5, -2.1, 0.6, 1.9, -0.7])
    pose = np.eye(4)
    for (a, d, quarter_turns), angle in zip([*rows, (0, 0.107, 0)], [*q, 0.0], strict=True):
        ca, sa = np.cos(quarter_turns * np.pi / 2), np.sin(quarter_turns * np.pi / 2)
        c, s = np.cos(angle), np.sin(angle)
        pose = pose @ [[c, -s, 0, a], [s * ca, c * ca, -sa, -d * sa], [s * sa, c * sa, ca, d * ca], [0, 0, 0, 1]]
    data = mujoco.MjData(model)
    data.qpos[:] = q
    mujoco.mj_forward(model, data)
    base, hand = data.body("robot_base"), data.body("robot_hand")
    np.testing.assert_allclose(base.xmat.reshape(3, 3).T @ (hand.xpos - base.xpos), pose[:3, 3], atol=1e-9)
    tool_z = (data.site("tcp").xpos - hand.xpos) / PANDA.tcp_z_m
    np.testing.assert_allclose(base.xmat.reshape(3, 3).T @ tool_z, pose[:3, 2], atol=1e-9)
    np.testing.assert_allclose(data.site("tcp").xmat.reshape(3, 3)[:, 2], tool_z, atol=1e-9)


def test_limits_are_those_of_the_arm(model: mujoco.MjModel) -> None:
    names = [f"robot_joint{i}" for i in range(1, 8)]
    assert [model.joint(n).id for n in names] == list(range(7))
    np.testing.assert_allclose(model.jnt_actfrcrange[:, 1], [87] * 4 + [12] * 3)
    np.testing.assert_allclose(model.jnt_range[3], [-3.0718, -0.0698])
    q = np.array(PROTOCOL.scene.parked_joint_rad)
    assert (q > model.jnt_range[:, 0]).all()
    assert (q < model.jnt_range[:, 1]).all()


def test_joint_range_does_not_depend_on_the_specs_angle_unit(model: mujoco.MjModel) -> None:
    spec = mujoco.MjSpec()
    spec.compiler.degree = not spec.compiler.degree
    add_robot(spec, PROTOCOL)
    np.testing.assert_allclose(spec.compile().jnt_range, model.jnt_range)


def test_parked_tool_points_down(model: mujoco.MjModel) -> None:
    assert parked(model).site("tcp").xmat.reshape(3, 3)[2, 2] < -0.999


def test_cap_is_the_outermost_part_of_the_hand(model: mujoco.MjModel) -> None:
    data = parked(model)
    hand, tcp = model.body("robot_hand").id, data.site("tcp")
    out = tcp.xmat.reshape(3, 3)[:, 2]
    cap = model.geom("robot_tool_cap").id
    assert model.geom_size[cap, 0] == pytest.approx(PANDA.tool_radius_m)
    assert (data.geom_xpos[cap] - tcp.xpos) @ out == pytest.approx(-PANDA.tool_radius_m)
    for geom in np.flatnonzero((model.geom_bodyid == hand) & (model.geom_type == mujoco.mjtGeom.mjGEOM_MESH)):
        mesh = model.geom_dataid[geom]
        first, n = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
        vertices = model.mesh_vert[first : first + n] @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom]
        assert ((vertices - tcp.xpos) @ out).max() < -PANDA.tool_radius_m / 4


def test_the_mitt_s_pad_is_as_far_out_as_the_cap_and_gives_way(model: mujoco.MjModel) -> None:
    spec = mujoco.MjSpec()
    add_robot(spec, overridden(PROTOCOL, {"scene.tool": "mitt"}))
    mitt = spec.compile()
    pad = mitt.geom("robot_tool_pad")
    assert pad.type[0] == mujoco.mjtGeom.mjGEOM_ELLIPSOID
    assert pad.pos[2] + pad.size[2] == pytest.approx(PANDA.tcp_z_m)
    assert pad.user[0] == PANDA_MITT.tip.give_m3_n > 0
    assert model.nuser_geom == 0, "a model without a mitt is what it was"
    np.testing.assert_array_equal(mitt.site("tcp").pos, model.site("tcp").pos)


def test_collision_bits_and_groups(model: mujoco.MjModel) -> None:
    for i in range(model.ngeom):
        geom = model.geom(i)
        if geom.contype[0]:
            assert (geom.contype[0], geom.conaffinity[0]) == (1, 0)
            assert geom.group[0] == 3 or geom.name == "robot_tool_cap"
        else:
            assert (geom.conaffinity[0], geom.group[0]) == (0, 1)
    colliding = {model.geom(i).name for i in range(model.ngeom) if model.geom_contype[i]}
    assert {"robot_tool_cap", "robot_collision_hand_0", "robot_collision_link5_0"} <= colliding


def test_arm_never_collides_with_itself(model: mujoco.MjModel) -> None:
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    for _ in range(50):
        data.qpos[:] = rng.uniform(model.jnt_range[:, 0], model.jnt_range[:, 1])
        mujoco.mj_forward(model, data)
        assert data.ncon == 0


def test_mass_and_size_of_the_asset(model: mujoco.MjModel) -> None:
    mass = arrays_of(PANDA.source)["mass_kg"].sum()
    assert model.body_subtreemass[model.body("robot_base").id] == pytest.approx(mass)
    assert 15 < model.body_mass.sum() < 20
    assert 8_000 < model.mesh_facenum.sum() < 16_000


def test_base_under_the_floor_is_refused() -> None:
    scene = PROTOCOL.scene.model_copy(update={"robot_base_m": (0.0, 1.0, -0.1)})
    with pytest.raises(SceneError, match="above the floor"):
        add_robot(mujoco.MjSpec(), PROTOCOL.model_copy(update={"scene": scene}))


def lost_steps(tip: Tip, newton: float, *, solimp: tuple[float, ...], giving: bool) -> int:
    """Return how many of the last 250 steps of a glide over the flank's plate have no contact."""
    give, kind = GIVES["flank"], mujoco.mjtJoint.mjJNT_SLIDE
    spec = mujoco.MjSpec()
    set_physics(spec, dt_s=0.002)
    spec.option.gravity = np.zeros(3)
    plate = spec.worldbody.add_body(explicitinertial=True, mass=give.mass_kg, inertia=np.full(3, 1e-4))
    plate.add_joint(type=kind, axis=[0, 0, 1], stiffness=[give.a_n_m, 0, 0], damping=[give.damping_ns_m, 0, 0])
    plate.add_geom(
        type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.2, 0.1, 0.01], pos=[0, 0, -0.01], mass=0,
        friction=[0.5, 0.005, 0.0001], solref=list(SOLREF), solimp=list(solimp), priority=1,
    )  # fmt: skip
    tool = spec.worldbody.add_body(pos=[0, 0, tip.half_m[2]])
    for axis in np.eye(3):
        tool.add_joint(type=kind, axis=axis)
    geom = tool.add_geom(type=mujoco.mjtGeom.mjGEOM_ELLIPSOID, size=tip.half_m, mass=4.4)
    if giving:
        make_giving(spec, geom, tip)
    model = spec.compile()
    data, touches = mujoco.MjData(model), []
    for step in range(750):
        moves = 0.06 * (step >= 250)
        data.qfrc_applied[1:] = np.array([moves, 0, 0]) * 600 - np.array([600, 600, 30]) * data.qvel[1:]
        data.qfrc_applied[3] -= newton
        mujoco.mj_step(model, data)
        touches.append(data.ncon)
    return 250 - sum(touches[500:])


@pytest.mark.parametrize("newton", [4.0, 8.0])
def test_a_tool_keeps_contact_with_a_plate_that_it_glides_over_if_either_gives_way(newton: float) -> None:
    for tip in (PANDA.tip, PANDA_MITT.tip):
        assert lost_steps(tip, newton, solimp=SOLIMP, giving=False) > 10
    assert lost_steps(PANDA.tip, newton, solimp=RIGID_TOOL_SOLIMP, giving=False) == 0
    assert lost_steps(PANDA_MITT.tip, newton, solimp=SOLIMP, giving=True) == 0


def test_only_a_rigid_tool_changes_how_hulls_meet_it() -> None:
    found: dict[str, set[tuple[float, ...]]] = {}
    for tool in ("caps", "mitt"):
        spec, *_ = build_spec(overridden(PROTOCOL, {"scene.tool": tool}), target="forearm", skin=False)
        hulls = [geom for geom in spec.geoms if geom.name.startswith(("human_hull_", "human_core_"))]
        assert len(hulls) > 40
        found[tool] = {(*geom.solref, *geom.solimp) for geom in hulls}
    assert found["mitt"] == {(*SOLREF, *SOLIMP), (*BARE_SOLREF, *BARE_SOLIMP)}
    assert found["caps"] == {(*SOLREF, *RIGID_TOOL_SOLIMP), (*BARE_SOLREF, *BARE_RIGID_TOOL_SOLIMP)}

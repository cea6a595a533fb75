"""The compiled world for every shipped body and target."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import astuple

import mujoco
import numpy as np
import pytest

from carecontact.human.hulls import PLATES, plate_body
from carecontact.human.pose import FIXED_SEGMENTS
from carecontact.human.skeleton import body_name
from carecontact.human.soft_region import tissue_of
from carecontact.interface.policy import CAMERAS
from carecontact.interface.regions import REGIONS, STANDARD_REGIONS
from carecontact.interface.robot import PANDA
from carecontact.protocol.load import DEFAULT_PROTOCOL, load_protocol
from carecontact.recording.schema import SEGMENTS
from carecontact.tissue.plugin import Law, Readings
from carecontact.world.scene import CONTACT_SLOTS, HAND_SENSOR, TIP_SENSOR, Scene, build_scene, plate_sensor

PROTOCOL = load_protocol("bathing-v3")
# Every body is built and settled in test_every_body.
BODIES = ("man-adult", "woman-old-heavy")
TARGETS = (*STANDARD_REGIONS, None)
QUICK = (("man-adult", "forearm"), ("woman-old-heavy", None))
"""A target changes nothing but the skin, which test_every_target_has_the_same_person_and_only_its_skin_is_finer holds;
the other worlds are slow tests."""
ROBOT_BIT, PERSON_BIT = 1, 2


@pytest.fixture(
    scope="module",
    params=[pytest.param((b, t), marks=[] if (b, t) in QUICK else pytest.mark.slow) for b in BODIES for t in TARGETS],
    ids=lambda p: f"{p[0]}-{p[1] or 'all fine'}",
)
def scene(request: pytest.FixtureRequest, scene_of: Callable[[str | None], Scene]) -> Scene:
    name, target = request.param
    if name == load_protocol(DEFAULT_PROTOCOL).person.body:
        return scene_of(target)
    person = PROTOCOL.person.model_copy(update={"body": name})
    return build_scene(PROTOCOL.model_copy(update={"person": person}), target=target)


@pytest.fixture
def target(request: pytest.FixtureRequest) -> str | None:
    return request.node.callspec.params["scene"][1]


@pytest.fixture
def model(scene: Scene) -> mujoco.MjModel:
    return scene.model


def owner_segment(model: mujoco.MjModel, body: int) -> str | None:
    """Segment that a body of the model is or hangs on."""
    names = {body_name(s): s for s in SEGMENTS}
    while body:
        name = model.body(body).name
        if name in names:
            return names[name]
        body = int(model.body_parentid[body])
    return None


def colliders(model: mujoco.MjModel) -> Iterator[tuple[str, str, int, int]]:
    """(name, whose, contype, conaffinity) of every geom that can collide."""
    for g in range(model.ngeom):
        if not (model.geom_contype[g] or model.geom_conaffinity[g]):
            continue
        name, body = model.geom(g).name, model.geom_bodyid[g]
        on = model.body(model.body_rootid[body]).name
        kind = "robot" if on == "robot_base" else "human" if on == body_name("pelvis") else "bed"
        yield name, kind, int(model.geom_contype[g]), int(model.geom_conaffinity[g])


def test_persons_mass_is_the_bodys(scene: Scene) -> None:
    model = scene.model
    assert model.body_subtreemass[model.body("human_pelvis").id] == pytest.approx(scene.body.mass_kg, rel=1e-6)
    assert model.body_mass[1:].min() >= 0
    for region, soft in scene.regions.items():
        # The shell's mass is part of its bone's.
        bone = model.body_mass[model.body(body_name(REGIONS[region].segment)).id]
        assert 0 < soft.tissue.areal_mass_kg_m2 * soft.shell.area.sum() < bone, region


def test_physics_is_the_protocols(model: mujoco.MjModel) -> None:
    assert model.opt.timestep == PROTOCOL.physics.dt_s
    assert model.opt.integrator == mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    assert model.opt.cone == mujoco.mjtCone.mjCONE_ELLIPTIC


def test_who_can_touch_whom(model: mujoco.MjModel) -> None:
    """The robot meets person and bed, the person's back meets the bed, and nothing meets its own kind."""
    rows = list(colliders(model))
    kinds = {"robot": set(), "human": set(), "bed": set()}
    met: set[frozenset[str]] = set()
    for i, (a, whose_a, type_a, affinity_a) in enumerate(rows):
        kinds[whose_a].add(a)
        for b, whose_b, type_b, affinity_b in rows[i + 1 :]:
            if type_a & affinity_b or type_b & affinity_a:
                assert whose_a != whose_b, (a, b)
                met.add(frozenset((whose_a, whose_b)))
                if "robot" not in (whose_a, whose_b):
                    person = a if whose_a == "human" else b
                    assert person.startswith("human_proxy_"), (a, b)
    assert met == {frozenset(pair) for pair in (("robot", "human"), ("robot", "bed"), ("human", "bed"))}
    assert min(map(len, kinds.values())) >= 3


def test_robot_meets_every_segment(model: mujoco.MjModel) -> None:
    met: set[str | None] = set()
    for g in range(model.ngeom):
        if model.geom_conaffinity[g] & ROBOT_BIT:
            met.add(owner_segment(model, int(model.geom_bodyid[g])))
    assert met >= set(SEGMENTS)


def test_proxies_meet_only_the_bed(model: mujoco.MjModel) -> None:
    proxies = [g for g in range(model.ngeom) if model.geom(g).name.startswith("human_proxy_")]
    assert len(proxies) >= 15
    assert {(int(model.geom_contype[g]), int(model.geom_conaffinity[g])) for g in proxies} == {(PERSON_BIT, 0)}
    assert {int(model.geom_group[g]) for g in proxies} == {3}


def test_every_contact_would_be_sensed(model: mujoco.MjModel) -> None:
    """One net force and one normal sum for each segment of the recording, and the normal sums of tip and hand; what a
    shell feels the plugin says."""
    sensors = {model.sensor(i).name: i for i in range(model.nsensor)}
    surfaces = {s: body_name(s) for s in SEGMENTS}
    surfaces |= {plate_sensor(p.name): plate_body(p.name) for p in PLATES}
    expected = {f"{kind}_{name}" for kind in ("net", "normal") for name in surfaces}
    of_contact = {n for n, i in sensors.items() if model.sensor_type[i] == mujoco.mjtSensor.mjSENS_CONTACT}
    assert of_contact == {*expected, TIP_SENSOR, HAND_SENSOR}
    tip, hand = (model.sensor(name) for name in (TIP_SENSOR, HAND_SENSOR))
    assert model.geom(tip.objid[0]).name == PANDA.tip.geom
    assert model.body(hand.objid[0]).name == "robot_hand"
    assert {model.body(sensor.refid[0]).name for sensor in (tip, hand)} == {body_name("pelvis")}
    for name in expected:
        kind, _, place = name.partition("_")
        i = sensors[name]
        assert model.body(model.sensor_refid[i]).name == surfaces[place]
        assert model.body(model.sensor_objid[i]).name == "robot_base"
        slots = 1 if kind == "net" else CONTACT_SLOTS
        assert model.sensor_dim[i] == slots * (6 if kind == "net" else 4)
    touchable = {int(model.geom_bodyid[g]) for g in range(model.ngeom) if model.geom_conaffinity[g] == ROBOT_BIT}
    whose = {model.body(b).name for b in touchable}
    assert whose <= set(surfaces.values())
    for region in STANDARD_REGIONS:
        assert owner_segment(model, Readings(model, region).bone) == REGIONS[region].segment


def test_other_streams_of_the_recording_have_sensors(scene: Scene) -> None:
    names = {scene.model.sensor(i).name for i in range(scene.model.nsensor)}
    assert {f"q_{h.name}" for h in scene.hinges} <= names
    assert {"tcp_position", "tcp_quat", "tcp_velocity", "tcp_rotation", "wrist_position"} <= names
    assert {f"region_{r}_{part}" for r in STANDARD_REGIONS for part in ("position", "quat")} <= names
    assert not any(h.segment in FIXED_SEGMENTS for h in scene.hinges)
    moving = {h.segment for h in scene.hinges}
    assert {f"{s}_{n}" for s in ("left", "right") for n in ("upper_arm", "forearm", "hand")} <= moving
    assert set(scene.model.sensor_history[:, 0].tolist()) == {10}


def test_a_finer_step_keeps_every_sample_of_a_period() -> None:
    fine = PROTOCOL.model_copy(update={"physics": PROTOCOL.physics.model_copy(update={"dt_s": 0.001})})
    model = build_scene(fine, target="abdomen", skin=False).model
    assert model.opt.timestep == 0.001
    assert set(model.sensor_history[:, 0].tolist()) == {20}


def test_every_target_has_the_same_person_and_only_its_skin_is_finer(
    scene: Scene, target: str | None, scene_of: Callable[..., Scene]
) -> None:
    assert list(scene.regions) == list(scene.frames) == list(STANDARD_REGIONS)
    for name, region in scene.regions.items():
        assert region.tissue == tissue_of(scene.body, name, PROTOCOL.person.tissue[name])
    if scene.body.name == PROTOCOL.person.body:
        plain = scene_of(None).model
        for field in ("body_mass", "body_inertia", "geom_pos", "numeric_data", "jnt_stiffness", "dof_damping"):
            np.testing.assert_array_equal(getattr(scene.model, field), getattr(plain, field), err_msg=field)
        assert (scene.model.nskinvert > plain.nskinvert) is (target is not None)


def test_shells_are_anchored_by_the_law(scene: Scene) -> None:
    """Law and surface, as the plugin reads them, are those of the protocol and of the body."""
    model = scene.model
    for name, region in scene.regions.items():
        np.testing.assert_array_equal(model.numeric(f"{name}/law").data, astuple(Law.of(region.tissue)))
        felt, segment = Readings(model, name), REGIONS[name].segment
        np.testing.assert_allclose(felt.places, region.shell.vertices - scene.body.joint_centre[segment], atol=1e-12)
        np.testing.assert_allclose(felt.frames[:, 0], -region.shell.normals, atol=1e-12)
        np.testing.assert_allclose(felt.areas, region.shell.area, rtol=1e-12)


def test_cameras_are_those_of_the_protocol_and_look_where_it_says(model: mujoco.MjModel) -> None:
    assert {model.camera(i).name for i in range(model.ncam)} == set(CAMERAS)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    for name, camera in PROTOCOL.cameras.items():
        made = model.camera(name)
        assert made.fovy[0] == camera.fovy_deg
        assert model.cam_resolution[made.id].tolist() == [camera.width, camera.height]
        mount = data.body("world" if camera.mount == "world" else "robot_hand")
        turn = mount.xmat.reshape(3, 3)
        position, target = (mount.xpos + turn @ np.array(p) for p in (camera.position_m, camera.look_at_m))
        axes = data.camera(name).xmat.reshape(3, 3)
        np.testing.assert_allclose(data.camera(name).xpos, position, atol=1e-9)
        np.testing.assert_allclose(-axes[:, 2], (target - position) / np.linalg.norm(target - position), atol=1e-9)
        assert axes[:, 1] @ turn @ np.array(camera.up) > 0, "upside down"


def test_person_lies_on_the_back_on_the_bed_head_to_plus_x(scene: Scene) -> None:
    model, data = scene.model, mujoco.MjData(scene.model)
    mujoco.mj_forward(model, data)
    at = {s: data.body(body_name(s)).xpos for s in SEGMENTS}
    assert at["head"][0] > at["thorax"][0] > at["pelvis"][0] > at["right_foot"][0]
    assert at["right_hand"][1] > 0 > at["left_hand"][1]
    top = PROTOCOL.scene.mattress_top_m
    assert all(top - 0.01 < p[2] < top + 0.35 for p in at.values())
    assert max(abs(at[s][0]) for s in ("head", "right_foot", "left_foot")) < 1.0
    # The abdomen's region frame points to the ceiling and to the head.
    x, _, z = data.site("region_abdomen").xmat.reshape(3, 3).T
    # The trunk lies within 1.5 degrees of level.
    assert (x[0], z[2]) == pytest.approx((1.0, 1.0), abs=1e-3)


def test_region_frames_lie_on_their_bones(scene: Scene) -> None:
    for region in STANDARD_REGIONS:
        site = scene.model.site(f"region_{region}")
        assert scene.model.body(site.bodyid[0]).name == body_name(REGIONS[region].segment)


def test_parked_robot_touches_nothing_and_the_arm_never_meets_itself(scene: Scene) -> None:
    model, data = scene.model, mujoco.MjData(scene.model)
    joints = [model.joint(f"robot_joint{i}").qposadr[0] for i in range(1, 8)]
    robot = np.array([model.body(model.body_rootid[b]).name == "robot_base" for b in model.geom_bodyid])
    data.qpos[joints] = PROTOCOL.scene.parked_joint_rad
    mujoco.mj_forward(model, data)
    assert not any(robot[g] for c in data.contact[: data.ncon] for g in c.geom if g >= 0)
    rng = np.random.default_rng(0)
    ranges = np.array([model.joint(f"robot_joint{i}").range for i in range(1, 8)])
    for _ in range(5):
        data.qpos[joints] = rng.uniform(ranges[:, 0], ranges[:, 1])
        mujoco.mj_kinematics(model, data)
        mujoco.mj_collision(model, data)
        assert not any(all(g >= 0 and robot[g] for g in c.geom) for c in data.contact[: data.ncon])


@pytest.mark.usefixtures("worlds_from_scratch")
def test_same_protocol_same_model(scene_of: Callable[[str | None], Scene]) -> None:
    again = build_scene(PROTOCOL, target="abdomen")
    assert again.model_sha256 == scene_of("abdomen").model_sha256
    assert again.model_sha256 != scene_of("forearm").model_sha256


def test_skin_is_for_the_eye_only(scene_of: Callable[[str | None], Scene]) -> None:
    bare, dressed = build_scene(PROTOCOL, target="abdomen", skin=False).model, scene_of("abdomen").model
    assert (bare.nskin, dressed.nskin) == (0, 1)
    assert (bare.nv, bare.ngeom, bare.nsensor) == (dressed.nv, dressed.ngeom, dressed.nsensor)
    for field in ("body_mass", "body_inertia", "geom_size", "jnt_stiffness", "dof_damping", "sensor_dim"):
        np.testing.assert_array_equal(getattr(bare, field), getattr(dressed, field), err_msg=field)

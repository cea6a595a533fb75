"""The whole world as one MjSpec with its cameras and sensors, and the named handles into it."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import mujoco
import numpy as np

from carecontact.errors import SceneError
from carecontact.human.body import Array, Body
from carecontact.human.breathing import add_muscles, add_servos, add_slide, carrier, move_skin
from carecontact.human.foam import FoamPatch
from carecontact.human.hulls import PLATES, meet_rigid_tool, plate_body, plate_under
from carecontact.human.joints import Hinge
from carecontact.human.library import load_body
from carecontact.human.mesh import refined
from carecontact.human.pose import NOT_TURNED, ArmTurn, free_middle, root_position, trunk_rotation
from carecontact.human.shell import Shell, cached_shell, limb_shell, trunk_shell
from carecontact.human.skeleton import RegionFrame, add_skeleton, body_name, rigid_frame, soft_frame, upward_in_bind
from carecontact.human.skin import add_skin
from carecontact.human.soft_region import SoftRegion, add_tissue, tissue_of
from carecontact.interface.regions import REGIONS, Belly, Tube
from carecontact.interface.robot import CARTESIAN_IMPEDANCE, CONTROLS, Control, Robot
from carecontact.protocol.person import Alive, Tissue
from carecontact.protocol.protocol import Protocol
from carecontact.protocol.sections import Camera
from carecontact.recording.schema import SEGMENTS
from carecontact.tissue.life import add_life
from carecontact.world.draws import UNMOVED, Place
from carecontact.world.robot import add_robot, replace_impedance
from carecontact.world.room import add_furniture, add_light, add_towel


def look_at(camera: Camera) -> np.ndarray:
    """Return the orientation (4,) wxyz of a MuJoCo camera (x right, y up, looking along -z)."""
    position, target = np.array(camera.position_m), np.array(camera.look_at_m)
    z = position - target
    z /= np.linalg.norm(z)
    x = np.cross(np.array(camera.up), z)
    x /= np.linalg.norm(x)
    quat = np.zeros(4)
    mujoco.mju_mat2Quat(quat, np.stack([x, np.cross(z, x), z], 1).ravel())
    return quat


def add_cameras(spec: mujoco.MjSpec, protocol: Protocol) -> None:
    for name, camera in protocol.cameras.items():
        parent = spec.worldbody if camera.mount == "world" else spec.body(protocol.scene.robot.flange_body)
        size = [camera.width, camera.height]
        parent.add_camera(name=name, pos=camera.position_m, quat=look_at(camera), fovy=camera.fovy_deg, resolution=size)


CONTACT_SLOTS = 12
"""Number of contacts for each segment that the sum of normal forces can hold; a recording says so if a segment ever had
more at once."""

# Bits of mjtConDataField in MuJoCo 4.0, in the order of their values in a slot.
FOUND_BIT, FORCE_BIT, POS_BIT = 1 << 0, 1 << 1, 1 << 4
NETFORCE, MAXFORCE = 3, 2

Named = tuple[mujoco.mjtObj, str]
"""Kind and name of an element of the model."""
TIP_SENSOR, HAND_SENSOR = "normal_by_tip", "normal_by_hand"
"""Contact of the robot's tip, and of its whole hand with the tip, with any rigid surface of the person. They say which
part of the robot the sensors of segments felt; one more sensor for each part and segment would make a step a tenth
slower."""


def plate_sensor(plate: str) -> str:
    """Return the part of the names of a plate's sensors that follows ``net_`` and ``normal_``."""
    return f"plate_{plate}"


def add_sensors(spec: mujoco.MjSpec, hinges: list[Hinge], protocol: Protocol) -> None:
    """Add sensors for the scorer alone: of every segment, every scored joint and every region of the protocol.

    The sensors of segments measure contact with their rigid surfaces; the compiled tissue measures that with soft
    shells. One control period is one call into C between two moves of the target, and the sensors keep all of its
    steps, so that no peak is lost.
    """
    samples = round(protocol.physics.target_period_s / protocol.physics.dt_s)
    kind, obj = mujoco.mjtSensor, mujoco.mjtObj

    def add(name: str, sensor: mujoco.mjtSensor, objtype: mujoco.mjtObj, objname: str, **more: Any) -> None:
        spec.add_sensor(name=name, type=sensor, objtype=objtype, objname=objname, nsample=samples, **more)

    def contact(name: str, first: Named, second: Named, *intprm: int) -> None:
        add(name, kind.mjSENS_CONTACT, *first, reftype=second[0], refname=second[1], intprm=intprm)

    names = protocol.scene.robot
    robot, person = (obj.mjOBJ_XBODY, names.base_body), (obj.mjOBJ_XBODY, body_name("pelvis"))
    net, normal = (FORCE_BIT | POS_BIT, NETFORCE, 1), (FOUND_BIT | FORCE_BIT, MAXFORCE, CONTACT_SLOTS)
    surfaces = {segment: body_name(segment) for segment in SEGMENTS}
    surfaces |= {plate_sensor(plate.name): plate_body(plate.name) for plate in PLATES}
    for name, body in surfaces.items():
        contact(f"net_{name}", robot, (obj.mjOBJ_BODY, body), *net)
        contact(f"normal_{name}", robot, (obj.mjOBJ_BODY, body), *normal)
    contact(TIP_SENSOR, (obj.mjOBJ_GEOM, names.tip.geom), person, *normal)
    contact(HAND_SENSOR, (obj.mjOBJ_BODY, names.flange_body), person, *normal)
    for hinge in hinges:
        add(f"q_{hinge.name}", kind.mjSENS_JOINTPOS, obj.mjOBJ_JOINT, f"human_{hinge.name}")
    add("tcp_position", kind.mjSENS_FRAMEPOS, obj.mjOBJ_SITE, names.tcp_site)
    add("tcp_quat", kind.mjSENS_FRAMEQUAT, obj.mjOBJ_SITE, names.tcp_site)
    add("tcp_velocity", kind.mjSENS_FRAMELINVEL, obj.mjOBJ_SITE, names.tcp_site)
    add("tcp_rotation", kind.mjSENS_FRAMEANGVEL, obj.mjOBJ_SITE, names.tcp_site)
    add("wrist_position", kind.mjSENS_FRAMEPOS, obj.mjOBJ_XBODY, body_name("right_hand"))
    for region in protocol.regions:
        add(f"region_{region}_position", kind.mjSENS_FRAMEPOS, obj.mjOBJ_SITE, f"region_{region}")
        add(f"region_{region}_quat", kind.mjSENS_FRAMEQUAT, obj.mjOBJ_SITE, f"region_{region}")


@dataclass(frozen=True, kw_only=True)
class Scene:
    model: mujoco.MjModel
    protocol: Protocol
    body: Body
    hinges: tuple[Hinge, ...]
    regions: dict[str, SoftRegion]
    """The soft regions, by name."""
    frames: dict[str, RegionFrame]
    """Frame of every region of the protocol, in the protocol's order."""
    spec: mujoco.MjSpec
    """The spec that ``model`` was compiled from."""
    control: Control = CONTROLS[CARTESIAN_IMPEDANCE]
    """The controller that moves the robot."""
    place: Place = UNMOVED
    """Place to which the person was moved after the compilation."""
    foam: FoamPatch | None = None
    """Foam on the skin, painted after the compilation."""

    @property
    def robot(self) -> Robot:
        return self.protocol.scene.robot

    @property
    def turn(self) -> ArmTurn:
        """How the right arm is turned."""
        return arm_turn(self.protocol)

    @property
    def region_size_m(self) -> Array:
        """(R, 3) [m]: length along the axis, mean radius (abdomen: half width), outward radius at the middle."""
        return np.array([frame.size_m for frame in self.frames.values()])

    @property
    def model_sha256(self) -> str:
        """Hash of the compiled model's bytes, which identifies the physics of a recording."""
        buffer = np.zeros(mujoco.mj_sizeModel(self.model), np.uint8)
        mujoco.mj_saveModel(self.model, None, buffer)
        return hashlib.sha256(buffer.tobytes()).hexdigest()


def build_spec(
    protocol: Protocol, *, target: str | None, skin: bool = True
) -> tuple[mujoco.MjSpec, Body, list[Hinge], dict[str, SoftRegion], dict[str, RegionFrame]]:
    """Build the world without compiling it. Returns the spec, the body, its hinges, the soft regions, and the frames of
    all regions.

    Args:
        target: the region around which the visual skin has fine triangles; None refines it nowhere.
        skin: whether the visual skin is added.
    """
    body, breathes = load_body(protocol.person.body), protocol.person.alive.breathing is not None
    spec = mujoco.MjSpec()
    spec.modelname = "carecontact"
    # Threads do not make so small a model faster, and none may be left where a policy of this machine starts many.
    spec.compiler.usethread = False
    # This comes first, because it sets the units of everything that is added later.
    set_physics(spec, dt_s=protocol.physics.dt_s)

    add_robot(spec, protocol)
    root = root_position(body, protocol.scene.mattress_top_m)
    hinges, regions = _add_person(spec, body, protocol, root)
    if not protocol.scene.robot.tip.give_m3_n:
        meet_rigid_tool(spec)
    frames = {
        name: soft_frame(regions[name].shell) if name in regions else rigid_frame(body, name, arm_turn(protocol))
        for name in protocol.regions
    }
    for name, frame in frames.items():
        _add_region_site(spec, body, name, frame, breathes=breathes)
    if skin:
        add_skin(spec, body if target is None else refined(body, REGIONS[target].segment, times=2))
        if breathes:
            move_skin(spec, body)
    head_x = root[0] + body.joint_centre["head"][2] - body.joint_centre["pelvis"][2] + 0.04
    add_furniture(spec, protocol.scene, head_x=head_x, head_y=float(root[1]))
    if protocol.distractors is not None:
        add_towel(spec, protocol.distractors.towel_m)
    add_light(spec)
    add_cameras(spec, protocol)
    if protocol.person.alive != Alive():
        add_life(spec, spec.body(body_name("head")))
    add_sensors(spec, hinges, protocol)
    return spec, body, hinges, regions, frames


def _add_person(
    spec: mujoco.MjSpec, body: Body, protocol: Protocol, root: Array
) -> tuple[list[Hinge], dict[str, SoftRegion]]:
    """Add skeleton and shells, with the pelvis at ``root`` (3,) [m]."""
    quat = np.zeros(4)
    mujoco.mju_mat2Quat(quat, trunk_rotation(body).ravel())
    alive, soft = protocol.person.alive, protocol.soft_regions
    breathes = alive.breathing is not None
    front = add_slide if breathes else None
    hinges = add_skeleton(spec, body, root_position=root, root_quat=quat, soft_regions=soft, front=front)
    if breathes:
        add_servos(spec)
    if alive.uses_the_arm:
        add_muscles(spec)
    regions: dict[str, SoftRegion] = {}
    robot, turn = protocol.scene.robot, arm_turn(protocol)
    tools, tip = robot.base_body, robot.tip.geom
    for region in soft:
        tissue, segment = tissue_of(body, region, protocol.person.tissue[region]), REGIONS[region].segment
        shell = cached_shell(body, region, tissue, partial(region_shell, body, region, tissue, turn), turn=turn)
        on, under = carrier(segment, breathes=breathes), plate_under(segment)
        floor = None if under is None else plate_body(under)
        regions[region] = add_tissue(spec, body, region, shell, tissue, tools=tools, tip=tip, on=on, floor=floor)
    return hinges, regions


def _add_region_site(spec: mujoco.MjSpec, body: Body, region: str, frame: RegionFrame, *, breathes: bool) -> None:
    segment, quat = REGIONS[region].segment, np.zeros(4)
    mujoco.mju_mat2Quat(quat, frame.axes.ravel())
    spec.body(carrier(segment, breathes=breathes)).add_site(
        name=f"region_{region}", pos=frame.origin - body.joint_centre[segment], quat=quat, group=5, size=[0.005] * 3
    )


def build_scene(protocol: Protocol, *, target: str | None, skin: bool = True) -> Scene:
    """Compile the world. The angle of the comfort arm is not part of the model: it is set when the person settles."""
    spec, body, hinges, regions, frames = build_spec(protocol, target=target, skin=skin)
    handles = {"body": body, "hinges": tuple(hinges), "regions": regions, "frames": frames}
    return Scene(model=spec.compile(), protocol=protocol, spec=spec, **handles)


def controlled(scene: Scene, control: Control) -> Scene:
    """Return the same world, as compiled, with the robot under a joint control; ``scene`` is not changed."""
    assert control.joint is not None
    spec = scene.spec.copy()
    replace_impedance(spec, scene.robot, control.joint)
    return replace(scene, model=spec.compile(), spec=spec, control=control)


def copy_settings(source: mujoco.MjModel, target: mujoco.MjModel) -> None:
    """Copy what was changed after the compilation: appearance, light, place of the person, rest angles."""
    kept = ("actuator_", "tendon_", "wrap_", "sensor_", "name", "_", "jnt_actfrcrange")
    for name in dir(source):
        value = None if name.startswith(kept) else getattr(source, name)
        if isinstance(value, np.ndarray) and value.shape == getattr(target, name).shape:
            getattr(target, name)[:] = value


def set_physics(spec: mujoco.MjSpec, *, dt_s: float) -> None:
    """Set units, integrator and solver, the same for scene and tissue bench, so that both respond alike."""
    spec.compiler.degree = False
    spec.option.timestep = dt_s
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    # Soft friction creeps: in 10 s, an arm on its board drifted by 1.2 deg at the default ratio of 1, by 0.4 deg at 10.
    spec.option.impratio = 10.0


def arm_turn(protocol: Protocol) -> ArmTurn:
    """Return how the right arm of the protocol's person is turned."""
    person = protocol.person
    return ArmTurn(shoulder_rotation_deg=person.shoulder_rotation_deg, palm_deg=person.palm_deg)


def region_shell(body: Body, region: str, tissue: Tissue, turn: ArmTurn = NOT_TURNED) -> Shell:
    """Return a region's shell on a body, in the mesh frame of the bind pose. Raises SceneError for a rigid region."""
    segment, shape = REGIONS[region].segment, REGIONS[region].shape
    match shape:
        case Tube():
            middle = free_middle(body, segment) if shape.beside_trunk else 0.5
            return limb_shell(body, segment, shape, upward_in_bind(body, segment, turn), tissue, middle=middle)
        case Belly():
            return trunk_shell(body, np.array([0.0, -1.0, 0.0]), tissue)
        case None:
            raise SceneError(f"region {region} is rigid: it has no shell")

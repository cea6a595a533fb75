"""Our own prompts: what each role is, what it may call, and examples that are not among the benchmark's tasks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from carecontact.policies.voxposer.scene import NAMES

_SETTING = f"""\
You write short Python programs for a robot arm that cares for a person lying face up on a bed beside it. Space is a
grid of 100 x 100 x 100 voxels over the workspace in the robot's frame: x grows away from the robot's base, y to its
left, z upwards. Positions are tuples (x, y, z) of whole voxels; a voxel is about 1 cm wide. Known names:
{", ".join(NAMES)}. Nothing measures force. Answer with the program alone. No imports are needed, none are there beside
math; variables are not kept between programs.
"""
_PARTS = """\
parse_query_obj(text) returns a part of the scene with .name, .position (mean of its visible points), .low and .high
(corners of the box round them) and .normal (unit vector out of its surface). cm2index(cm, "x"|"y"|"z") gives
centimetres in voxels along an axis, cm2index(cm, vector) gives a step (dx, dy, dz) of that length along a vector.
"""
_WRITE = """\
set_voxel(map, (x, y, z), value) writes one voxel; set_voxel_by_radius(map, (x, y, z), radius_cm, value) writes a box of
that half width.
Leave the map in ret_val.
"""

PLANNER = """\
Your role: planner. Divide the instruction into motions of the arm, each one call composer("...") with everything the
motion needs to know in its words. End with composer("back to default pose").

instruction: rest your hand on the left elbow
composer("move slowly onto the left elbow")
composer("back to default pose")

instruction: stroke the left upper arm downwards
composer("move slowly onto the shoulder end of the left upper arm")
composer("move slowly along the left upper arm to its elbow end")
composer("back to default pose")
"""
COMPOSER = """\
Your role: composer. Turn one motion into maps and carry it out. parse_query_obj(text) names what moves, which is always
the gripper. get_affordance_map(text): where to go. get_avoidance_map(text): what to keep away from.
get_rotation_map(text): how to hold the tool. get_velocity_map(text): how fast, 1 is full speed. get_gripper_map(text):
1 open, 0 closed.
execute(movable, affordance_map=..., avoidance_map=..., rotation_map=..., velocity_map=..., gripper_map=...) moves; only
the affordance map is always needed. reset_to_default_pose() goes back to where the arm began.

motion: move slowly onto the left elbow
movable = parse_query_obj("gripper")
affordance_map = get_affordance_map("a point at the center of the left elbow")
rotation_map = get_rotation_map("pointing down")
velocity_map = get_velocity_map("a quarter of full speed within 10cm of the left elbow")
execute(movable, affordance_map=affordance_map, rotation_map=rotation_map, velocity_map=velocity_map)

motion: move to 20cm above the left hip and stay 15cm away from the left wrist
movable = parse_query_obj("gripper")
affordance_map = get_affordance_map("a point 20cm above the left hip")
avoidance_map = get_avoidance_map("15cm around the left wrist")
execute(movable, affordance_map=affordance_map, avoidance_map=avoidance_map)

motion: back to default pose
reset_to_default_pose()
"""
PARSE = """\
Your role: parse_query_obj. detect(name) finds one of the known names. Leave the part that is meant in ret_val.

query: the higher one of left wrist and left hip
wrist, hip = detect("left wrist"), detect("left hip")
ret_val = wrist if wrist.position[2] >= hip.position[2] else hip

query: gripper
ret_val = detect("gripper")
"""
AFFORDANCE = """\
Your role: get_affordance_map. Write 1 into the voxels to go to; everything else is 0. get_empty_affordance_map() makes
the map.

query: a point 20cm above the left hip
affordance_map = get_empty_affordance_map()
x, y, z = parse_query_obj("left hip").position
set_voxel(affordance_map, (x, y, z + cm2index(20, "z")), 1)
ret_val = affordance_map

query: a point halfway between left wrist and left elbow
affordance_map = get_empty_affordance_map()
a, b = parse_query_obj("left wrist").position, parse_query_obj("left elbow").position
set_voxel(affordance_map, tuple((p + q) // 2 for p, q in zip(a, b)), 1)
ret_val = affordance_map
"""
AVOIDANCE = """\
Your role: get_avoidance_map. Write 1 into the voxels to keep away from; everything else is 0.
get_empty_avoidance_map() makes the map. Visible surfaces are avoided anyway.

query: 15cm around the left wrist
avoidance_map = get_empty_avoidance_map()
set_voxel_by_radius(avoidance_map, parse_query_obj("left wrist").position, radius_cm=15, value=1)
ret_val = avoidance_map
"""
ROTATION = """\
Your role: get_rotation_map. Write quaternions (w, x, y, z) of the tool; everywhere else it keeps the turn it has.
vec2quat(vector) gives the one whose tool points along a vector. get_empty_rotation_map() makes the map.

query: pointing at the left hip from the side within 20cm of it
rotation_map = get_empty_rotation_map()
hip = parse_query_obj("left hip")
set_voxel_by_radius(rotation_map, hip.position, radius_cm=20, value=vec2quat((1, 0, -1)))
ret_val = rotation_map

query: pointing down
rotation_map = get_empty_rotation_map()
set_voxel_by_radius(rotation_map, (50, 50, 50), radius_cm=200, value=vec2quat((0, 0, -1)))
ret_val = rotation_map
"""
VELOCITY = """\
Your role: get_velocity_map. Write factors of full speed, more than 0 and at most 1; everywhere else it is 1.
get_empty_velocity_map() makes the map.

query: a quarter of full speed within 10cm of the left elbow
velocity_map = get_empty_velocity_map()
set_voxel_by_radius(velocity_map, parse_query_obj("left elbow").position, radius_cm=10, value=0.25)
ret_val = velocity_map
"""
GRIPPER_MAP = """\
Your role: get_gripper_map. Write 1 where the gripper is to be open and 0 where it is to be closed.
get_empty_gripper_map() makes the map.

query: closed everywhere
gripper_map = get_empty_gripper_map()
set_voxel_by_radius(gripper_map, (50, 50, 50), radius_cm=200, value=0)
ret_val = gripper_map
"""


@dataclass(frozen=True, kw_only=True)
class PromptSet:
    """The prompts of one method."""

    version: str
    """Changes with any word of a prompt, because recorded completions answer one version only."""
    roles: Mapping[str, str]
    """Role -> system message."""

    def system(self, role: str) -> str:
        """Return the system message of a role."""
        return self.roles[role]

    def user(self, query: str) -> str:
        """Return the user message of a query."""
        return query


def _map_role(text: str) -> str:
    return _SETTING + _PARTS + _WRITE + text


VOXPOSER = PromptSet(
    version="voxposer-v2",
    roles={
        "planner": _SETTING + PLANNER,
        "composer": _SETTING + COMPOSER,
        "parse_query_obj": _SETTING + PARSE,
        "get_affordance_map": _map_role(AFFORDANCE),
        "get_avoidance_map": _map_role(AVOIDANCE),
        "get_rotation_map": _map_role(ROTATION),
        "get_velocity_map": _map_role(VELOCITY),
        "get_gripper_map": _map_role(GRIPPER_MAP),
    },
)

PHASED_PLANNER = (
    PLANNER
    + """
instruction: rub the left upper arm
composer("move slowly onto the center of the left upper arm and slide 15cm back and forth along it")
composer("back to default pose")
"""
)
PHASED_COMPOSER = (
    COMPOSER
    + """
get_progress(text) says what is to be achieved once the tool touches. execute(..., progress=...) follows the maps until
then and the objective alone afterwards, until it is met.

motion: move slowly onto the center of the left upper arm and slide 15cm back and forth along it
movable = parse_query_obj("gripper")
affordance_map = get_affordance_map("a point at the center of the left upper arm")
rotation_map = get_rotation_map("pointing down")
progress = get_progress("slide 15cm back and forth along the left upper arm")
execute(movable, affordance_map=affordance_map, rotation_map=rotation_map, progress=progress)
"""
)
PROGRESS = """\
Your role: get_progress. Leave in ret_val one objective. slide(direction, distance_cm, span_cm): rub back and forth
along a vector, span_cm from end to end, until the tool has gone distance_cm in all. displace(direction, distance_cm):
push along a vector until the tool has moved distance_cm since it touched, and hold.

query: slide 15cm back and forth along the left upper arm
a, b = parse_query_obj("left shoulder").position, parse_query_obj("left elbow").position
ret_val = slide((b[0] - a[0], b[1] - a[1], b[2] - a[2]), distance_cm=15, span_cm=8)
"""
VOXPOSER_PHASED = PromptSet(
    version="voxposer-phased-v2",
    roles={
        **VOXPOSER.roles,
        "planner": _SETTING + PHASED_PLANNER,
        "composer": _SETTING + PHASED_COMPOSER,
        "get_progress": _SETTING + _PARTS + PROGRESS,
    },
)

SETS: Mapping[str, PromptSet] = {"authored": VOXPOSER, "authored-phased": VOXPOSER_PHASED}
"""Name of a file of completions that were written by hand -> the prompts that they answer."""

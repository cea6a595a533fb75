"""Every number of the method, with its source; all were fixed before the first scored run.

"Release" is huangwl18/VoxPoser at commit e3a4c9e: files of its folder src with line numbers, and "yaml" for
configs/rlbench_config.yaml. "Ours" means that the value is not published, or that it differs from the published one;
docs/voxposer.md gives the reasons.
"""

from __future__ import annotations

CONTROL_HZ = 20.0
"""Ours."""

MAP_SIZE = 100
"""Voxels along each axis of the workspace (release: yaml 29); 10, 12 and 7.5 mm in bathing-v3-draft."""
AFFORDANCE_WEIGHT, AVOIDANCE_WEIGHT = 2.0, 1.0
"""Release: yaml 7, 10; planners.py 42."""
AVOIDANCE_SIGMA_VOXELS = 10.0
"""Standard deviation of the Gaussian that spreads what is to be avoided (release: yaml 9; planners.py 39)."""
TARGET_FREE_VOXELS = 15
"""Closer to a target than this, the scene is not an obstacle, so that a target on a surface can be reached (release:
interfaces.py 385)."""
START_FREE_VOXELS = 10
"""Nor is it an obstacle in the cube of twice this width round the tool (release: interfaces.py 393-396)."""
NEIGHBOUR_VOXELS = 2
"""A step goes to one of the 124 voxels that are at most this far along each axis (release: planners.py 106, 114)."""
MAX_STEPS = 300
"""Release: yaml 8."""
STOP_THRESHOLD = 0.001
"""The walk ends where every neighbour costs more by at least this share of the largest cost (release: yaml 4;
planners.py 98)."""
VISITED_PENALTY = 1.0
"""Added to a voxel each time the path leaves it, the largest cost being 1 (release: planners.py 60-62)."""
SMOOTHING_WINDOW, SMOOTHING_ORDER = 20, 3
"""Window [points] and order of the Savitzky-Golay filter over the path (release: yaml 5-6; planners.py 128-130)."""
MAX_CURVATURE = 3.0
"""[1/voxel] The smoothed path is cut where it bends more sharply (release: yaml 13; planners.py 134)."""
CURVATURE_FROM = 5
"""The bend of the path's first points is not limited (release: planners.py 133-136)."""
KEPT_BEFORE_BEND = 0.9
"""Share of the points before the sharp bend that is kept (release: planners.py 137)."""
WAYPOINT_SPACING_VOXELS = 1.0
"""Points of the smoothed path that are closer than this are thinned out (release: yaml 12; planners.py 142-148). Steps
of the walk are about twice as long, so that each usually becomes a waypoint."""
REACHED_VOXELS = 2.0
"""A motion is over when the tool is this close to the target after a whole path (release: interfaces.py 177)."""
NEAR_END_M = 0.01
"""A tool that is this close to the last waypoint goes straight to it (release: interfaces.py 150, 205)."""
MAX_PLANS = 10
"""Ours: plans for one motion; then the program goes on, whether the target is reached or not. The release plans once
(yaml 31)."""

HORIZON_S = 1.5
"""Ours: how much of a plan is executed before the next look, from which the maps are composed again. The release
executes a plan to its end (yaml 30-31); the paper describes replanning at every step. One look costs 0.3 s of
computing, and the person moves slowly."""
SETTLE_S = 0.4
"""Ours: how long the end of a path is held, so that the tool arrives before its place is judged; one time constant of
the impedance. The release commands the last waypoint three more times, each until the arm is there (interfaces.py 376,
205)."""
FULL_SPEED_M_S = 0.25
"""Ours: the speed at velocity 1, which is the session's limit. The release hands the map's values to a controller that
ignores them (controllers.py 80-85; envs/rlbench_env.py 266)."""
MIN_VELOCITY = 0.1
"""Lowest velocity that counts: a tool at velocity 0 would never arrive. All values from here on are ours."""
ROTATION_SPEED_RAD_S = 0.8
"""Below the session's limit of 1.0 rad/s."""
HOME_LIMIT_S = 20.0
"""The way back is one stretch: nothing on it is composed."""

CONTACT_M = 0.005
"""voxposer-phased takes the skin as touched when the tool's cap is this close to where the skin was seen: the error of
a seen surface (docs/perception.md)."""
PRESS_M = 0.012
"""Depth below the seen skin while the tool slides: the state machine's lightest touch, three times the error of a seen
surface from overhead."""
SLIDE_SPEED_M_S = 0.08
"""The pace of washing by hand."""
DISPLACE_SPEED_M_S = 0.05
LEAD_STEP_M, LEAD_LIMIT_M = 0.015, 0.060
"""How far ahead of the tool its target is set while the limb does not follow: the step at each look and the limit. At
400 N/m the limit gives at most 24 N, which is the state machine's lighter push."""
DISPLACE_HOLD_S = 1.5
MAX_PROGRESS_LOOKS = 12
"""Number of looks after which an objective is given up."""
MAX_DISTANCE_CM = 100.0
SKIN_RADIUS_M = 0.012
"""Radius round a place within which seen points give the height of its skin: the cap's own radius."""

MAX_SUBTASKS = 12
"""More than any care task needs within the time limit."""
MAX_QUERY = 300
"""Characters that a query of one program to another may have: it goes into names, notes and prompts."""
MAX_MAP_ENTRIES = 1000
"""Entries of one map: the error that a program gets beyond this recommends radii."""
RADIUS_LIMIT_CM = 200.0
OCCLUDED_SHARE = 0.05
"""If a larger share of a part's pixels is behind the robot, the part keeps its last unhidden place: key points move by
centimetres when the arm is over a limb (docs/perception.md)."""
JOINT_RADIUS_M = 0.04
"""Radius of the surface that counts as a joint's: half the visible width of an adult elbow, rounded."""

"""Every number of the method, with its source. Fixed before the first scored run.

"Release": huangwl18/VoxPoser at commit e3a4c9e, folder src, read there; files with line numbers, "yaml" for
configs/rlbench_config.yaml. "Ours": not published, or another value than published; docs/voxposer.md says why.
"""

from __future__ import annotations

CONTROL_HZ = 20.0
"""Ours."""

MAP_SIZE = 100
"""Voxels along each axis of the workspace (release: yaml 29); 10, 12 and 7.5 mm in bathing-v1."""
AFFORDANCE_WEIGHT, AVOIDANCE_WEIGHT = 2.0, 1.0
"""Release: yaml 7, 10; planners.py 42."""
AVOIDANCE_SIGMA_VOXELS = 10.0
"""Of the Gaussian that spreads what is to be avoided (release: yaml 9; planners.py 39)."""
TARGET_FREE_VOXELS = 15
"""Nearer to a target the scene is no obstacle, so that one on a surface can be reached (release: interfaces.py 385)."""
START_FREE_VOXELS = 10
"""Nor in the cube of twice this width round the tool (release: interfaces.py 393-396)."""
NEIGHBOUR_VOXELS = 2
"""A step goes to one of the 124 voxels at most this far along each axis (release: planners.py 106, 114)."""
MAX_STEPS = 300
"""Release: yaml 8."""
STOP_THRESHOLD = 0.001
"""The walk ends where every neighbour is dearer by at least this share of the largest cost (release: yaml 4;
planners.py 98)."""
VISITED_PENALTY = 1.0
"""Added to a voxel each time the path leaves it, the largest cost being 1 (release: planners.py 60-62)."""
SMOOTHING_WINDOW, SMOOTHING_ORDER = 20, 3
"""Of the Savitzky-Golay filter over the path (release: yaml 5-6; planners.py 128-130)."""
MAX_CURVATURE = 3.0
"""[1/voxel] The smoothed path is cut where it bends more sharply (release: yaml 13; planners.py 134)."""
CURVATURE_FROM = 5
"""The path's first points may bend as they like (release: planners.py 133-136)."""
KEPT_BEFORE_BEND = 0.9
"""Of the points before the sharp bend (release: planners.py 137)."""
WAYPOINT_SPACING_VOXELS = 1.0
"""Points of the smoothed path that are closer are thinned out (release: yaml 12; planners.py 142-148). Steps of the
walk are about twice as long, so that as a rule each becomes a waypoint."""
REACHED_VOXELS = 2.0
"""A motion is over when the tool is within this of the target after a whole path (release: interfaces.py 177)."""
NEAR_END_M = 0.01
"""A tool this near to the last waypoint goes straight to it (release: interfaces.py 150, 205)."""
MAX_PLANS = 10
"""Ours: for one motion; then the program goes on, reached or not. The release plans once (yaml 31)."""

HORIZON_S = 1.5
"""Ours: of a plan this much is executed before the camera is looked at and the maps are composed again. The release
executes a plan to its end (yaml 30-31); the paper describes replanning at every step. One look costs 0.3 s of computing
and the person moves slowly."""
SETTLE_S = 0.4
"""Ours: at the end of a path, so that the tool arrives before its place is judged; one time constant of the impedance.
The release has the last waypoint commanded three times more, each until the arm is there (interfaces.py 376, 205)."""
FULL_SPEED_M_S = 0.25
"""Ours: at velocity 1 the session's limit. The release hands the map's values to a controller that ignores them
(controllers.py 80-85; envs/rlbench_env.py 266)."""
MIN_VELOCITY = 0.1
"""A velocity map of 0 would never arrive. From here on all is ours."""
ROTATION_SPEED_RAD_S = 0.8
"""Under the session's 1.0 rad/s."""
HOME_LIMIT_S = 20.0
"""The way back is one stretch: nothing on it is composed."""

CONTACT_M = 0.005
"""voxposer-phased takes the skin as touched when the tool's cap is this near to where it was seen: the error of a seen
surface (docs/perception.md)."""
PRESS_M = 0.012
"""Below the seen skin while it slides: the lightest touch of the state machine, three times that error."""
SLIDE_SPEED_M_S = 0.08
"""Hand-washing pace."""
DISPLACE_SPEED_M_S = 0.05
LEAD_STEP_M, LEAD_LIMIT_M = 0.015, 0.060
"""How far ahead of the tool its target is set while the limb does not follow, more at each look: at 400 N/m at most
24 N, which is the state machine's lighter push."""
DISPLACE_HOLD_S = 1.5
MAX_PROGRESS_LOOKS = 12
"""After which the objective is given up."""
MAX_DISTANCE_CM = 100.0
SKIN_RADIUS_M = 0.012
"""Round a place, of the points that tell the height of its skin: the cap's own radius."""

MAX_SUBTASKS = 12
"""More than any care task needs within the time limit."""
MAX_QUERY = 300
"""Characters of what one program asks of another: it goes into names, notes and prompts."""
MAX_MAP_ENTRIES = 1000
"""Of one map: a program that writes voxel by voxel is told to use radii."""
RADIUS_LIMIT_CM = 200.0
OCCLUDED_SHARE = 0.05
"""With more of a part's pixels behind the robot its last unhidden place is kept: key points move by centimetres when
the arm is over a limb (docs/perception.md)."""
JOINT_RADIUS_M = 0.04
"""Of the surface that counts as a joint's: half the visible width of an adult elbow, rounded."""

"""Every number of the method, with its source. Fixed before the first scored run.

"Published": as the method's paper or its released configuration has it.
"""

from __future__ import annotations

CONTROL_HZ = 20.0

MAP_SIZE = 100
"""Voxels along each axis of the workspace (published); 10, 12 and 7.5 mm in bathing-v1."""
AFFORDANCE_WEIGHT, AVOIDANCE_WEIGHT = 2.0, 1.0
"""Published."""
AVOIDANCE_SIGMA_VOXELS = 10.0
"""Of the Gaussian that spreads what is to be avoided (published)."""
FREE_RADIUS_VOXELS = 15
"""Round target and tool the scene itself is no obstacle, so that a target on a surface can be reached (published)."""
MAX_STEPS = 300
STOP_THRESHOLD = 0.001
"""The planner ends where no neighbour is better by more than this share of the largest cost (published)."""
VISITED_PENALTY = 1.0
"""Added to a voxel that the path has been through, the largest cost being 1, so that the path does not turn back."""
SMOOTHING_WINDOW, SMOOTHING_ORDER = 20, 3
"""Of the Savitzky-Golay filter over the path (published)."""
MAX_CURVATURE = 3.0
"""[1/voxel] The smoothed path is cut where it bends more sharply: beyond it the greedy search ran in circles
(published)."""
PATH_STRIDE = 5
"""Every fifth point of the smoothed path becomes a waypoint; the executor goes straight between them."""
SNAP_VOXELS = 20.0
"""A path that ends within this of the target gets the target itself as last waypoint (published)."""
REACHED_VOXELS = 2.0
"""A motion is over when the tool is within this of the target after a whole path (published)."""
MAX_PLANS = 10
"""For one motion; then the program goes on, reached or not."""

HORIZON_S = 1.5
"""Of a plan this much is executed before the camera is looked at and the maps are composed again. The published loop
replans at up to 5 Hz; here one look costs 0.3 s of computing and the person moves slowly."""
FULL_SPEED_M_S = 0.25
"""At velocity 1: the session's limit."""
MIN_VELOCITY = 0.1
"""A velocity map of 0 would never arrive."""
ROTATION_SPEED_RAD_S = 0.8
"""Under the session's 1.0 rad/s."""
HOME_LIMIT_S = 20.0
"""The way back is one stretch: nothing on it is composed."""
SETTLE_S = 0.4
"""At the end of a path: one time constant of the impedance, so that the tool arrives before its place is judged."""

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
MAX_MAP_ENTRIES = 1000
"""Of one map: a program that writes voxel by voxel is told to use radii."""
RADIUS_LIMIT_CM = 200.0
OCCLUDED_SHARE = 0.05
"""With more of a part's pixels behind the robot its last unhidden place is kept: key points move by centimetres when
the arm is over a limb (docs/perception.md)."""
JOINT_RADIUS_M = 0.04
"""Of the surface that counts as a joint's: half the visible width of an adult elbow, rounded."""

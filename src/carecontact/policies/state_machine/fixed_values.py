"""Every depth, speed and distance of the state machine, with its reason. Fixed before the first scored run.

With the default translational stiffness K = 400 N/m a commanded point d beyond the surface presses with K (d - tissue
deflection): 12 mm can give at most 4.8 N, 60 mm at most 24 N.
"""

from __future__ import annotations

CONTROL_HZ = 20.0
FREE_SPEED_M_S = 0.25
"""Limit of the session's target interpolation."""
NEAR_SPEED_M_S = 0.10
"""Within NEAR_M of the skin."""
NEAR_M = 0.030
HOVER_M = 0.060
"""Above the skin, where slow motion begins: twice NEAR_M, because a seen surface is 10 mm uncertain."""
ACCELERATION_M_S2 = 0.5
ROTATION_SPEED_RAD_S = 0.8
"""Under the session's 1.0 rad/s."""

TRAVEL_CLEARANCE_M = 0.12
"""Over the highest person point under the way: room for the hand's 0.1 m half width when it is tilted."""
TRAVEL_CORRIDOR_M = 0.15

DESCENT_SPEED_M_S = 0.04
"""Before strokes and pushes."""

TOUCH_DEPTHS_M = (0.012, 0.018)
"""Three times the 4 mm error of a surface seen from overhead; at most 4.8 and 7.2 N."""
TOUCH_SPEEDS_M_S = (0.03, 0.05)
TOUCH_DWELL_S = 2.0
"""A slow, clear rest: four times the shortest touch a person would call one, after the arm has caught up (0.3 s)."""
TOUCH_KEY_POINTS = (0.35, 0.5, 0.65)

SCRUB_DEPTHS_M = (0.015, 0.022)
"""Deeper than a touch, so that a surface that curves away from its profile by 5 mm stays in contact."""
SCRUB_SPEEDS_M_S = (0.07, 0.10)
"""Hand-washing pace, within the near-skin limit."""
SCRUB_HALF_STROKE_M = 0.060
SCRUB_PASSES = 3
"""From end to end, after half a pass from the middle, where the tool comes down: three turns."""
SCRUB_END_DWELL_S = 0.35
"""One time constant of the impedance: the tool reaches the stroke's end before it turns."""
SCRUB_END_MARGIN_M = 0.010
SCRUB_STEP_M = 0.010
SCRUB_KEY_POINTS = (0.45, 0.5, 0.55)

PUSH_OVERTRAVEL_M = (0.060, 0.075)
"""Past the limb's visible side: 20 mm for the limb to move, the rest for the spring to press, and at most 24 and 30 N
even if the limb did not move at all."""
PUSH_SPEEDS_M_S = (0.05, 0.08)
PUSH_HOLD_S = 2.0
PUSH_KEY_POINTS = (0.55, 0.7)
"""Middle and distal forearm: a longer lever about the elbow."""
PUSH_STANDOFF_M = 0.025
"""Between tool and limb where the tool comes down: twice the lateral error of a seen limb."""
PUSH_SUPPORT_CLEARANCE_M = 0.018
"""Of the tool's tip over the arm board."""
PUSH_TILT_RAD = 0.35
"""The hand leans back by 20 degrees, so that it does not overhang the limb it pushes."""
PUSH_BACK_OFF_M = 0.040
CAP_RADIUS_M = 0.012
"""Of the rounded fingertip cap, part of the embodiment's public description."""

SHOULDER_HEIGHT_M = 0.333
FLANGE_TO_TCP_M = 0.107 + 0.117
WRIST_OFFSET_M = 0.088
"""Panda: joint 2 over the base; joint 7's foot to TCP with this tool; joint 6 from joint 7's axis (its data sheet)."""
SHOULDER_TO_WRIST_M = (0.26, 0.712)
"""Joint 4 at about -2.9 and -0.75 rad: 0.2 rad from its folded limit, 0.3 rad from an elbow and wrist in line."""

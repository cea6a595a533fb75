"""Every depth, speed and distance of the state machine, with its reason; all were fixed before the first scored run.

Speeds of free motion are in ``policies.motion``. With the default translational stiffness K = 400 N/m, a point that is
commanded at a depth d below the surface presses with K (d - deflection of the tissue): 12 mm can give at most 4.8 N,
and 60 mm at most 24 N.
"""

from __future__ import annotations

NEAR_M = 0.030
"""Closer to the skin than this, the tool moves at the slower speed."""
HOVER_M = 0.060
"""Height above the skin at which slow motion begins: twice NEAR_M, because a seen surface is uncertain by 10 mm."""

TRAVEL_CORRIDOR_M = 0.15
"""Half width of the strip under the way in which the person's highest point is looked for."""

DESCENT_SPEED_M_S = 0.04
"""Speed of the way down before strokes and pushes."""

TOUCH_DEPTHS_M = (0.012, 0.018)
"""Three times the 4 mm error of a surface seen from overhead, or more; at most 4.8 and 7.2 N."""
TOUCH_SPEEDS_M_S = (0.03, 0.05)
TOUCH_DWELL_S = 2.0
"""A slow, clear rest: four times the shortest contact that a person would call a touch, after the arm has caught up
(0.3 s)."""
TOUCH_KEY_POINTS = (0.35, 0.5, 0.65)

SCRUB_DEPTHS_M = (0.015, 0.022)
"""Deeper than a touch, so that a surface that curves away from its profile by 5 mm stays in contact."""
SCRUB_SPEEDS_M_S = (0.07, 0.10)
"""The pace of washing by hand, within the speed limit near the skin."""
SCRUB_HALF_STROKE_M = 0.060
SCRUB_PASSES = 3
"""Passes from end to end, after half a pass from the middle, where the tool comes down: three turns."""
SCRUB_END_DWELL_S = 0.35
"""One time constant of the impedance: the tool reaches the end of the stroke before it turns."""
SCRUB_END_MARGIN_M = 0.010
SCRUB_STEP_M = 0.010
SCRUB_KEY_POINTS = (0.45, 0.5, 0.55)

PUSH_OVERTRAVEL_M = (0.060, 0.075)
"""How far past the limb's visible side the tool is commanded: 20 mm for the limb to move and the rest for the spring to
press. At most 24 and 30 N even if the limb did not move at all."""
PUSH_SPEEDS_M_S = (0.05, 0.08)
PUSH_HOLD_S = 2.0
PUSH_KEY_POINTS = (0.55, 0.7)
"""Middle and distal forearm: a longer lever about the elbow."""
PUSH_STANDOFF_M = 0.025
"""Gap between tool and limb where the tool comes down: twice the lateral error of a seen limb."""
PUSH_SUPPORT_CLEARANCE_M = 0.018
"""Height of the tool's tip over the arm board."""
PUSH_TILT_RAD = 0.35
"""The hand leans back by 20 degrees, so that it does not overhang the limb that it pushes."""
PUSH_BACK_OFF_M = 0.040

SHOULDER_HEIGHT_M = 0.333
"""Height of the Panda's joint 2 over its base (data sheet)."""
FLANGE_TO_TCP_M = 0.107 + 0.117
"""Along the axis of joint 7, from level with joint 6 to the flange (0.107 m, data sheet) and on to the tool centre
point (0.117 m, this tool)."""
WRIST_OFFSET_M = 0.088
"""Distance of joint 6 from the axis of joint 7 (data sheet)."""
SHOULDER_TO_WRIST_M = (0.26, 0.712)
"""The distance when joint 4 is at about -2.9 and -0.75 rad: 0.2 rad from its folded limit, and 0.3 rad from elbow and
wrist in one line."""

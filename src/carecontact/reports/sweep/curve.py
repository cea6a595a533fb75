"""The figure of success over levels.

Classes used: ``tick``, ``label``, ``name``, and for policy number N of the figure ``lineN``, ``dotN`` and ``whiskerN``.
"""

from __future__ import annotations

from carecontact.reports.svg import Axes, Drawing
from carecontact.reports.sweep.ladder import Ladder
from carecontact.reports.sweep.level_texts import level_name

COLOURS = 6
"""Of the style sheet; a seventh policy has the first one's colour again."""
BESIDE = 0.035
"""Of the way from level to level, between the points of neighbouring policies, so that their intervals stay apart."""


def curve_svg(found: Ladder) -> str:
    """Rate over level, a line for each policy with its interval at every level."""
    n, policies = len(found.rungs), found.policies
    told = "; ".join(
        f"{rung.value}: " + ", ".join(f"{c.policy} {c.rate.k} of {c.rate.n}" for c in rung.climbs)
        for rung in found.rungs
    )
    drawing = Drawing(width=440, height=270, style="curve", title=f"Success over level. {told}")
    axes = Axes(drawing=drawing, left=40, right=16, top=12, bottom=26, x=(-0.3, n - 0.7))
    axes.y_ticks((share / 100, f"{share} %") for share in (0, 25, 50, 75, 100))
    axes.x_labels([(k, short(rung.value)) for k, rung in enumerate(found.rungs)], style="name")
    for number, policy in enumerate(policies):
        aside, style = BESIDE * (number - (len(policies) - 1) / 2), style_of(found, policy)
        climbs = [(k + aside, c) for k, rung in enumerate(found.rungs) for c in rung.climbs if c.policy == policy]
        rates = [(x, c.rate.estimate, c.rate) for x, c in climbs if c.rate.estimate is not None]
        drawing.polyline(f"line {style}", [axes.point(x, estimate) for x, estimate, _ in rates])
        for x, estimate, rate in rates:
            drawing.path(f"whisker {style}", f"M{axes.px(x):.1f} {axes.py(rate.high):.1f}V{axes.py(rate.low):.1f}")
            drawing.circle(f"dot {style}", *axes.point(x, estimate), 3.2)
    return drawing.svg()


def style_of(found: Ladder, policy: str) -> str:
    """Classes of a policy's line: its role, and a colour of its own for a method or a probe."""
    role = next(climb.role for climb in found.rungs[0].climbs if climb.policy == policy)
    coloured = [c.policy for c in found.rungs[0].climbs if c.role in ("method", "probe")]
    return f"{role} c{coloured.index(policy) % COLOURS}" if policy in coloured else role


def short(value: str) -> str:
    """A level as the figure names it: ``L2`` of ``bathing-wide-v1 L2``, the stem of a file."""
    return level_name(value).rsplit(" ", 1)[-1]

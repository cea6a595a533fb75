"""Figure 1: how data flows through the benchmark, and which of it no policy receives."""

from __future__ import annotations

from typing import TYPE_CHECKING

from carecontact.reports.paper.figures.style import COLOURS, GREY

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

HEIGHT = 1.35
BOXES = {
    "cameras": (0.0, 3.0, 2.5, "Instruction, images", "RGB, depth, encoders"),
    "vision": (3.2, 3.0, 2.5, "Vision models", "points, masks,\nlandmarks"),
    "policy": (6.4, 3.0, 2.5, "Policy", "a process of its own"),
    "robot": (9.6, 3.0, 2.5, "Robot arm", "impedance control"),
    "person": (9.6, 0.0, 2.5, "Person", "soft tissue,\npassive joints"),
    "log": (6.4, 0.0, 2.5, "Log", "forces and joints\nat every step"),
    "scores": (3.2, 0.0, 2.5, "Scores", "C1 force, C2 joints,\nC4 motion, C5 steadiness"),
    "rates": (0.0, 0.0, 2.5, "Success (C3)", "region-correct,\nsafety-gated"),
}
"""Name -> left and lower edge, width, title, text."""
SEEN = (("cameras", "vision"), ("vision", "policy"), ("policy", "robot"))
HIDDEN = (("person", "log"), ("log", "scores"), ("scores", "rates"))


def draw(figure: Figure) -> None:
    figure.set_size_inches(7.2, 3.0)
    axes = figure.subplots()
    axes.set(xlim=(-0.15, 12.25), ylim=(-0.55, 5.0))
    axes.set_axis_off()
    for name, (x, y, width, title, text) in BOXES.items():
        colour = COLOURS[0] if y > 0 else COLOURS[1]
        _box(axes, x, y, width, title, text, colour=GREY if name == "person" else colour)
    for names, colour in ((SEEN, COLOURS[0]), (HIDDEN, COLOURS[1])):
        for a, b in names:
            _arrow(axes, _side(a, b), _side(b, a), colour)
    x, width = BOXES["robot"][0], BOXES["robot"][2]
    _arrow(axes, (x + 0.35 * width, 3.0), (x + 0.35 * width, HEIGHT), GREY)
    _arrow(axes, (x + 0.65 * width, HEIGHT), (x + 0.65 * width, 3.0), GREY)
    axes.text(x + 0.28 * width, 2.18, "contact", ha="right", va="center", color=GREY)
    axes.text(x + 0.72 * width, 2.18, "reaction", ha="left", va="center", color=GREY)
    axes.plot([9.9, 9.9, 1.25, 1.25], [HEIGHT, 1.75, 1.75, 2.85], color=GREY, lw=0.9, ls=(0, (4, 3)))
    _arrow(axes, (1.25, 2.8), (1.25, 3.0), GREY)
    axes.text(5.1, 1.87, "the next images", ha="center", va="bottom", color=GREY)
    axes.text(0, 4.62, "What a policy sees", color=COLOURS[0], weight="bold", va="bottom")
    axes.text(0, -0.48, "What the scorer alone sees", color=COLOURS[1], weight="bold", va="bottom")


def _box(axes: Axes, x: float, y: float, width: float, title: str, text: str, *, colour: str) -> None:
    from matplotlib.patches import FancyBboxPatch

    shape = "round,pad=0,rounding_size=0.12"
    axes.add_patch(FancyBboxPatch((x, y), width, HEIGHT, boxstyle=shape, fc="white", ec=colour, lw=1.2))
    axes.text(x + width / 2, y + HEIGHT - 0.16, title, ha="center", va="top", weight="bold", fontsize=7.5)
    axes.text(x + width / 2, y + 0.45, text, ha="center", va="center", fontsize=6.8, color=GREY, linespacing=1.15)


def _side(name: str, other: str) -> tuple[float, float]:
    """Return the middle of the edge that looks at the other box."""
    x, y, width = BOXES[name][:3]
    return (x + width if BOXES[other][0] > x else x), y + HEIGHT / 2


def _arrow(axes: Axes, start: tuple[float, float], end: tuple[float, float], colour: str) -> None:
    arrow = {"arrowstyle": "-|>", "color": colour, "lw": 1.2, "shrinkA": 1, "shrinkB": 1}
    axes.annotate("", end, start, arrowprops=arrow)

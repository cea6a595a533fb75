"""The bed from above: where the people lie, where the robot stands beside them, and which places were refused."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from carecontact.contract.protocol import Protocol
from carecontact.episode.draws import streams
from carecontact.episode.parking.bases import draws
from carecontact.episode.parking.grounds import REFUSALS
from carecontact.episode.parking.survey import Surveyed
from carecontact.plotting import plain_figures
from carecontact.world.furniture import BED_HALF_M
from carecontact.world.place import place_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
"""Colours of the regions, in their order (those of Okabe and Ito, which people with any colour vision can
distinguish)."""
REASONS = dict(zip(REFUSALS, ("#bbbbbb", "#8c6d31", "#e377c2", "#7f7f7f", "#bcbd22", "#17becf", "#000000", "#9467bd",
                              "#d62728", "#ff9896"), strict=True))  # fmt: skip
ARROW_M = 0.09
MOST_REFUSED = 40
"""Most refused draws that the map shows for one search: the last ones before the draw that serves."""


@plain_figures()
def draw_map(path: Path, rows: Sequence[tuple[Protocol, Sequence[Surveyed]]]) -> None:
    """Write a PNG or SVG picture, by the file's name, with one row of panels for each level.

    The left panel shows the places that serve, the right one the places that were refused beside the same people.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12, 5.6 * len(rows)), layout="constrained")
    panels = np.atleast_2d(figure.subplots(len(rows), 2))
    for (protocol, found), (taken, refused) in zip(rows, panels, strict=True):
        _ground(taken, protocol, f"{protocol.name}: where people lie and where the robot stands")
        _ground(refused, protocol, f"{protocol.name}: places that were refused")
        for each in found:
            _people(taken, protocol, each)
            _refused(refused, protocol, each)
        _legend(taken, {name: COLOURS[k % len(COLOURS)] for k, name in enumerate(protocol.regions)})
        shown = {reason for each in found for reason in each.refused}
        _legend(refused, {reason: colour for reason, colour in REASONS.items() if reason in shown})
    figure.savefig(path, dpi=110)


def _ground(axes: Axes, protocol: Protocol, title: str) -> None:
    from matplotlib.patches import Rectangle

    length, width = BED_HALF_M
    axes.add_patch(Rectangle((-width, -length), 2 * width, 2 * length, facecolor="#e8eef2", edgecolor="#8899a0"))
    axes.text(0.0, length - 0.1, "head end", ha="center", color="#667780", fontsize=8)
    axes.set(xlim=(1.15, -0.5), ylim=(-0.75, 1.05), aspect="equal", title=title, xlabel="y, to the person's right [m]",
             ylabel="x, to the head [m]")  # fmt: skip
    axes.title.set_fontsize(10)


def _people(axes: Axes, protocol: Protocol, each: Surveyed) -> None:
    if each.found is None:
        return
    laid = each.found.laid.at(place_of(each.found.posture.place, protocol.variation))
    axes.plot(laid.limb[:, 1], laid.limb[:, 0], color="#555555", linewidth=0.5, alpha=0.6)
    for number, name in enumerate(protocol.regions):
        colour, base = COLOURS[number % len(COLOURS)], each.found.bases[name]
        axes.plot(laid.skin[number, :, 1], laid.skin[number, :, 0], color=colour, linewidth=1.6, alpha=0.6)
        x, y, _ = base.position_m
        ahead = ARROW_M * base.turn[:2, 0]
        axes.annotate(
            "", xy=(y + ahead[1], x + ahead[0]), xytext=(y, x),
            arrowprops={"arrowstyle": "-|>", "color": colour, "linewidth": 0.8, "alpha": 0.8},
        )  # fmt: skip


def _refused(axes: Axes, protocol: Protocol, each: Surveyed) -> None:
    parking = protocol.variation.parking
    if each.found is None or parking is None:
        return
    for region, reasons in each.found.refused.items():
        drawn = streams(protocol, each.seed, each.salt)
        bases = list(islice(draws(parking, region, place=drawn["park"], height=drawn["bed_height"]), len(reasons)))
        for base, reason in list(zip(bases, reasons, strict=True))[-MOST_REFUSED:]:
            axes.plot(base.position_m[1], base.position_m[0], ".", color=REASONS[reason], markersize=3, alpha=0.6)


def _legend(axes: Axes, colours: dict[str, str]) -> None:
    for name, colour in colours.items():
        axes.plot([], [], "s", color=colour, label=name.replace("_", " "))
    if colours:
        axes.legend(loc="lower right", fontsize=8, framealpha=0.9)

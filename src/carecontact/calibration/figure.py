"""The calibration figure: measured trials, identified response, calibrated simulation."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from carecontact.calibration.curve import GRID, Curve
from carecontact.calibration.identify import Identified
from carecontact.calibration.replay import Group, Replayed
from carecontact.plotting import plain_figures

GRAY, GOLD, BLUE = "0.7", "#c8960c", "#1f5fa8"


@plain_figures()
def write_figure(
    path: Path,
    *,
    title: str,
    curves: Sequence[Curve],
    groups: Sequence[Group],
    replayed: Sequence[Replayed],
    identified: Identified,
    extrapolated_mm: float,
) -> None:
    """Force over indentation, one panel per speed; the deepest measured point is marked by a dotted line."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    speeds = sorted({group.condition.speed_m_s for group in groups})
    figure = Figure(figsize=(0.6 + 2.7 * len(speeds), 3.0), dpi=200, layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(1, len(speeds), sharey=True, sharex=True, squeeze=False)[0]
    for speed, axes in zip(speeds, panels, strict=True):
        for curve in curves:
            if curve.trial.condition.speed_m_s == speed:
                touched = curve.depth_m > -0.1 * curve.deepest_m
                axes.plot(
                    1000 * curve.depth_m[touched], curve.force_n[touched], color=GRAY, lw=1.8, alpha=0.8, zorder=1
                )
        mine = [(g, one) for g, one in zip(groups, replayed, strict=True) if g.condition.speed_m_s == speed]
        for group, one in mine:
            depth = 1000 * GRID * group.deepest_m
            axes.plot(depth, one.loading_n, color=BLUE, lw=0.9, zorder=2)
            axes.plot(depth, one.unloading_n, color=BLUE, lw=0.9, zorder=2)
        longest = max((curves[k] for g, _ in mine for k in g.members), key=lambda curve: curve.deepest_m)
        for at in (longest.loading_m_s, longest.unloading_m_s):
            axes.plot(1000 * longest.grid_m, identified.force_n(longest.grid_m, at), "--", color=GOLD, lw=1.2, zorder=3)
        axes.axvline(extrapolated_mm, color="0.3", lw=0.7, ls=":")
        axes.set_title(f"{1000 * speed:g} mm/s, {sum(len(g.members) for g, _ in mine)} trials", fontsize=8)
        axes.set_xlabel("indentation past touch [mm]", fontsize=8)
        axes.tick_params(labelsize=7)
        axes.spines[["top", "right"]].set_visible(False)
    panels[0].set_ylabel("force [N]", fontsize=8)
    for colour, style, label in (
        (GRAY, "-", "trials"),
        (GOLD, "--", f"identified: {identified.law.name}"),
        (BLUE, "-", "calibrated simulation"),
    ):
        panels[0].plot([], [], style, color=colour, lw=1.8 if colour == GRAY else 1.1, label=label)
    panels[0].legend(frameon=False, fontsize=7, loc="upper left")
    figure.suptitle(title, fontsize=9)
    figure.savefig(path)

"""One picture of all that an observation holds, made from the observation alone."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from carecontact.errors import ConfigError
from carecontact.interface.observation import CameraView, Observation
from carecontact.plotting import plain_figures

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

F64 = npt.NDArray[np.float64]
U8 = npt.NDArray[np.uint8]

ENDINGS = (".png", ".jpg", ".pdf")
DPI = 110
WIDTH_IN, HEADER_IN, GAP_IN, FOOT_IN, CLOUD_IN = 16.0, 0.95, 0.46, 0.3, 5.0
COLUMNS = ("rgb", "depth", "masks", "landmarks")
INK, FAINT = "#1f2a36", "#6b7785"
MASK_COLOURS = {"human": (236, 120, 48), "robot": (40, 120, 214), "bed": (64, 170, 150), "background": (120, 120, 128)}
MASK_OPACITY = {"human": 0.62, "robot": 0.62, "bed": 0.42, "background": 0.45}
LEFT, RIGHT, MIDDLE = "#35b6ff", "#ff9d2e", "#ffffff"
BONES = (
    (11, 12), (23, 24), (11, 23), (12, 24), (11, 13), (13, 15), (15, 19), (12, 14), (14, 16), (16, 20),
    (23, 25), (25, 27), (27, 31), (24, 26), (26, 28), (28, 32),
)  # fmt: skip
"""Pairs of MediaPipe Pose landmarks; odd numbers are the left side."""
SURE = 0.5
CLOUD_MARGIN_M = 0.35
BELOW_M = 0.25
VIEWS = {"from behind the robot": (0.0, 32.0), "from the robot's left": (-90.0, 32.0)}
"""Azimuth of the line of sight about the vertical of the base, 0 along its x axis, and elevation above it [deg]."""


def check_sheet_path(path: Path) -> Path:
    """Raises ConfigError for an ending that is not a picture's or a folder that is not there."""
    if path.suffix.lower() not in ENDINGS:
        raise ConfigError(f"--out {path}: a picture ends in {', '.join(ENDINGS)}")
    if not path.resolve().parent.is_dir():
        raise ConfigError(f"--out {path}: there is no folder {path.parent}")
    return path


@plain_figures()
def save_sheet(observation: Observation, path: Path, *, title: str, dpi: int = DPI) -> Path:
    """Draw every camera and modality that is there. Raises ConfigError as ``check_sheet_path``.

    Args:
        title: what the observation itself does not say, such as task and seed.
    """
    check_sheet_path(path)
    figure = draw_sheet(observation, title=title)
    extra: dict[str, Any] = {"pil_kwargs": {"quality": 85}} if path.suffix.lower() == ".jpg" else {}
    figure.savefig(path, dpi=dpi, facecolor="white", **extra)
    return path


@plain_figures()
def draw_sheet(observation: Observation, *, title: str) -> Figure:
    """Return a picture with a row for each camera, a column for each image modality, then the cloud from two sides and
    the encoders."""
    from matplotlib.figure import Figure

    views = {name: view for name, view in observation.cameras.items() if _shape(view) is not None}
    columns = [c for c in COLUMNS if any(getattr(view, c) is not None for view in views.values())]
    cell = WIDTH_IN / max(len(columns), 1)
    around = GAP_IN + FOOT_IN
    heights = [cell * 0.94 * shape[0] / shape[1] + around for view in views.values() if (shape := _shape(view))]
    total = HEADER_IN + sum(heights) + CLOUD_IN
    figure = Figure(figsize=(WIDTH_IN, total))
    figure.text(0.012, 1 - 0.36 / total, f"“{observation.instruction}”", size=21, weight="bold", color=INK, va="center")
    figure.text(0.012, 1 - 0.72 / total, f"What a policy sees at t = {observation.sim_time_s:.2f} s.  {title}",
                size=12, color=FAINT, va="center")  # fmt: skip
    top = total - HEADER_IN
    for (name, view), height in zip(views.items(), heights, strict=True):
        for column, modality in enumerate(columns):
            left, width = (column + 0.03) / len(columns), 0.94 / len(columns)
            axes = figure.add_axes((left, (top - height + FOOT_IN) / total, width, (height - around) / total))
            _bare(axes)
            if getattr(view, modality) is None:
                axes.set_axis_off()
                continue
            _PANELS[modality](axes, view)
            _caption(axes, f"{name}: {_TITLES[modality]}", _size_of(view, modality))
        top -= height
    _draw_below(figure, observation, views, total)
    return figure


def _draw_below(figure: Figure, observation: Observation, views: dict[str, CameraView], total: float) -> None:
    bottom, height = 0.5 / total, (CLOUD_IN - 1.05) / total
    points, colors, count = _merged(views)
    if len(points):
        for k, (name, (azimuth, elevation)) in enumerate(VIEWS.items()):
            axes = figure.add_axes((0.04 + 0.385 * k, bottom, 0.355, height))
            _cloud_panel(axes, points, colors, azimuth, elevation)
            cameras = f"{len(views)} camera{'s' * (len(views) > 1)}"
            cut = f"cropped to {len(points):,} of {count:,} points" if len(points) < count else f"{count:,} points"
            axes.set_xlabel(f"across the picture [m]; {cut}", size=8.5, color=FAINT, labelpad=1)
            _caption(axes, f"points {name}", cameras)
    axes = figure.add_axes((0.795, bottom, 0.195, height))
    axes.set_axis_off()
    _caption(axes, "robot's encoders", "")
    pose = observation.pose_tcp_in_base
    rows = [("joint", "position [rad]", "speed [rad/s]")]
    rows += [
        (f"{k + 1}", f"{q:+.4f}", f"{v:+.4f}")
        for k, (q, v) in enumerate(zip(observation.joint_position, observation.joint_velocity, strict=True))
    ]
    lines = [f"{a:<6}{b:>15}{c:>15}" for a, b, c in rows]
    lines += ["", "TCP in base", "  x y z [m]    " + " ".join(f"{x:+.3f}" for x in pose[:3])]
    lines += ["  quat wxyz    " + " ".join(f"{x:+.2f}" for x in pose[3:])]
    lines += [f"  gripper      {observation.gripper_position[0]:.0f} (closed)" if observation.gripper_position[0] == 0
              else f"  gripper      {observation.gripper_position[0]:.2f}"]  # fmt: skip
    axes.text(0.0, 0.98, "\n".join(lines), family="monospace", size=9.5, color=INK, va="top", linespacing=1.5)


def _rgb_panel(axes: Axes, view: CameraView) -> None:
    assert view.rgb is not None
    axes.imshow(view.rgb)


def _depth_panel(axes: Axes, view: CameraView) -> None:
    from matplotlib import colormaps

    assert view.depth is not None
    colours = colormaps["viridis_r"].with_extremes(bad="#d8d8dc")
    low, high = np.nanpercentile(view.depth, [0.5, 99.5]) if np.isfinite(view.depth).any() else (0.0, 1.0)
    image = axes.imshow(view.depth, cmap=colours, vmin=low, vmax=high, interpolation="nearest")
    assert axes.figure is not None
    y = _foot(axes)
    axes.figure.colorbar(image, cax=axes.inset_axes((0.14, 1.3 * y, 0.4, -0.6 * y)), orientation="horizontal", ticks=[])
    for x, text, side in ((0.13, f"{low:.2f}", "right"), (0.55, f"{high:.2f} m", "left")):
        axes.text(x, y, text, transform=axes.transAxes, size=9, color=FAINT, ha=side, va="center")


def _masks_panel(axes: Axes, view: CameraView) -> None:
    from matplotlib.patches import Patch

    assert view.masks is not None
    shape = next(iter(view.masks.values())).shape
    image = np.full((*shape, 3), 255.0) if view.rgb is None else view.rgb.astype(np.float64)
    image = 0.35 * image + 0.65 * image.mean(2, keepdims=True)
    handles = []
    for name, mask in view.masks.items():
        colour, share = np.array(MASK_COLOURS[name], np.float64), MASK_OPACITY[name]
        image[mask] = (1 - share) * image[mask] + share * colour
        handles.append(Patch(color=tuple(colour / 255), label=f"{name} {100 * mask.mean():.0f} %"))
    axes.imshow(image.clip(0, 255).astype(np.uint8))
    axes.legend(handles=handles, loc="center left", bbox_to_anchor=(0, _foot(axes)), ncols=4, fontsize=7.5,
                frameon=False, borderpad=0, borderaxespad=0, handlelength=0.9, handletextpad=0.4, columnspacing=0.7,
                labelcolor=FAINT)  # fmt: skip


def _landmarks_panel(axes: Axes, view: CameraView) -> None:
    assert view.landmarks is not None
    shape = _shape(view)
    assert shape is not None
    backdrop = np.full((*shape, 3), 60, np.uint8) if view.rgb is None else view.rgb
    axes.imshow((backdrop * 0.62).astype(np.uint8))
    marks = view.landmarks
    if not np.isfinite(marks).any():
        label = axes.text(0.5, 0.5, "no person found", transform=axes.transAxes, ha="center", color="white", size=15)
        _halo(label, "black")
        return
    for a, b in BONES:
        sure = min(marks[a, 2], marks[b, 2]) >= SURE
        colour = MIDDLE if a % 2 != b % 2 else LEFT if a % 2 else RIGHT
        axes.plot(marks[[a, b], 0], marks[[a, b], 1], color=colour, lw=2.0 if sure else 1.0,
                  ls="-" if sure else (0, (2, 2)), alpha=0.95 if sure else 0.6, solid_capstyle="round")  # fmt: skip
    sides = [MIDDLE if k == 0 else LEFT if k % 2 else RIGHT for k in range(len(marks))]
    sides[1:7] = [LEFT] * 3 + [RIGHT] * 3  # the eyes come three by three
    axes.scatter(marks[:, 0], marks[:, 1], s=np.where(np.arange(len(marks)) < 11, 4, 15), c=sides, zorder=3,
                 edgecolors="black", linewidths=0.5, alpha=np.clip(marks[:, 2], 0.25, 1).tolist())  # fmt: skip
    axes.set_xlim(-0.5, shape[1] - 0.5)
    axes.set_ylim(shape[0] - 0.5, -0.5)
    hidden = int((marks[:, 2] < SURE).sum())
    unsure = f"{hidden} with visibility < {SURE:g} (dashed)" if hidden else ""
    for x, text, colour in ((0.0, "left", LEFT), (0.09, "right", RIGHT), (0.21, unsure, FAINT)):
        weight = "normal" if colour == FAINT else "bold"
        axes.text(x, _foot(axes), text, transform=axes.transAxes, color=colour, size=9, weight=weight, va="center")


def _cloud_panel(axes: Axes, points: F64, colors: U8, azimuth_deg: float, elevation_deg: float) -> None:
    image, extent = splat(points, colors, azimuth_deg=azimuth_deg, elevation_deg=elevation_deg)
    axes.imshow(image, extent=extent, interpolation="nearest")
    axes.set_facecolor("white")
    axes.tick_params(labelsize=8, colors=FAINT, length=2)
    axes.set_ylabel("up the picture [m]", size=8.5, color=FAINT, labelpad=1)
    axes.set_xticks(np.arange(np.ceil(extent[0] * 2) / 2, extent[1], 0.5))
    axes.set_yticks(np.arange(np.ceil(extent[2] * 2) / 2, extent[3], 0.5))
    axes.set_anchor("NW")


def splat(
    points: F64, colors: U8, *, azimuth_deg: float, elevation_deg: float, pixel_m: float = 0.004
) -> tuple[U8, tuple[float, float, float, float]]:
    """(N, 3) points [m], (N, 3) colours -> a parallel projection on white, nearer points over farther ones.

    Returns the (H, W, 3) image and its extent left, right, bottom, top [m].
    """
    a, e = np.radians([azimuth_deg, elevation_deg])
    toward = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), -np.sin(e)])
    right = np.array([np.sin(a), -np.cos(a), 0.0])
    up = np.cross(right, toward)
    x, y = points @ right, points @ up
    order = np.argsort(-(points @ toward))
    left, low = x.min() - 0.02, y.min() - 0.02
    width, height = (int(np.ptp(v) / pixel_m) + 12 for v in (x, y))
    image = np.full((height, width, 3), 255, np.uint8)
    column = ((x[order] - left) / pixel_m).astype(int).clip(0, width - 2)
    row = (height - 1 - (y[order] - low) / pixel_m).astype(int).clip(0, height - 2)
    # One point at a time over all of its pixels: a far one must not cover a near one's corner.
    rows, columns = (
        np.stack([v, v, v + 1, v + 1], 1) if v is row else np.stack([v, v + 1, v, v + 1], 1) for v in (row, column)
    )
    image[rows, columns] = colors[order][:, None]
    return image, (float(left), float(left + width * pixel_m), float(low), float(low + height * pixel_m))


def _merged(views: dict[str, CameraView]) -> tuple[F64, U8, int]:
    """Return those points of all cameras' clouds that are near the person, or near the middle where no mask shows the
    person; and the number of all points."""
    points = [v.points for v in views.values() if v.points is not None and v.point_colors is not None]
    if not points:
        return np.zeros((0, 3)), np.zeros((0, 3), np.uint8), 0
    colors = [v.point_colors for v in views.values() if v.points is not None and v.point_colors is not None]
    everything, tint = np.concatenate(points).astype(np.float64), np.concatenate(colors)
    anchors = [
        v.points[v.masks["human"][np.isfinite(v.depth)]]
        for v in views.values()
        if v.points is not None and v.masks is not None and v.depth is not None
    ]
    anchor = np.concatenate(anchors).astype(np.float64) if anchors else everything
    if not len(anchor):
        anchor = everything
    low, high = np.percentile(anchor, [1, 99], axis=0)
    low, high = low - [CLOUD_MARGIN_M, CLOUD_MARGIN_M, BELOW_M], high + [CLOUD_MARGIN_M, CLOUD_MARGIN_M, 1.0]
    inside = ((everything > low) & (everything < high)).all(1)
    return everything[inside], tint[inside], len(everything)


def _shape(view: CameraView) -> tuple[int, int] | None:
    """(H, W) of the view's images; landmarks and points alone have none."""
    images = (view.rgb, view.depth, *(view.masks or {}).values())
    return next(((image.shape[0], image.shape[1]) for image in images if image is not None), None)


def _size_of(view: CameraView, modality: str) -> str:
    shape = _shape(view)
    assert shape is not None
    size = f"{shape[1]} x {shape[0]} px"
    if modality == "landmarks":
        return "33 x (u, v [px], visibility)"
    if modality == "depth" and view.depth is not None:
        return f"{size}, [m]; grey: none"
    return size


def _caption(axes: Axes, text: str, size: str) -> None:
    axes.set_title(text, loc="left", size=11.5, color=INK, pad=5, weight="bold")
    axes.set_title(size, loc="right", size=9, color=FAINT, pad=5)


def _foot(axes: Axes) -> float:
    """Middle of the strip below a picture, in heights of the picture: keys stand there and cover nothing of it."""
    assert axes.figure is not None
    return -0.5 * FOOT_IN * axes.figure.dpi / axes.bbox.height


def _bare(axes: Axes) -> None:
    axes.set_xticks([])
    axes.set_yticks([])
    for spine in axes.spines.values():
        spine.set_color("#c4cad1")


def _halo(text: Any, colour: str) -> None:
    from matplotlib.patheffects import withStroke

    text.set_path_effects([withStroke(linewidth=2, foreground=colour)])


_PANELS = {"rgb": _rgb_panel, "depth": _depth_panel, "masks": _masks_panel, "landmarks": _landmarks_panel}
_TITLES = {"rgb": "RGB", "depth": "depth", "masks": "masks over RGB", "landmarks": "landmarks"}

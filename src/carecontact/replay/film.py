"""Paints the frames of a video with several processes, and encodes them."""

from __future__ import annotations

import os
import pickle
import signal
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cache
from importlib import import_module
from itertools import groupby
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt
from PIL import Image

from carecontact.episode.randomization import randomize_appearance, set_place
from carecontact.errors import DependencyError, RecordingError
from carecontact.human.foam import FoamPatch
from carecontact.recording.schema import Recording
from carecontact.replay.panel import HEIGHT as PANEL_HEIGHT
from carecontact.replay.panel import PAPER, Panel, Picture, Story, box, faded, story_of, text_width, write
from carecontact.replay.panel import WIDTH as PANEL_WIDTH
from carecontact.replay.replay import KIND_TEXTS, STATE, Kind, Replay, ReplayQuality
from carecontact.replay.stage import FilmSkin, SkinGrid, Stage, film_scene
from carecontact.replay.views import CONTACT, Camera, ViewAt, check_view, clear_view, view_of
from carecontact.report.timeline import Event
from carecontact.scoring.foam import RecordedWiping
from carecontact.tissue import plugin

INSET = (268, 151)
"""(width, height) of the small picture of the room [px]"""
EVENT_S = 1.6
"""Time for which the picture shows the text of an event [s]."""


@dataclass(frozen=True, kw_only=True)
class Moment:
    """What one frame shows."""

    time_s: float
    """since t = 0"""
    state: npt.NDArray[np.float64]
    """integration state"""
    kind: Kind
    foam_left: npt.NDArray[np.float64] | None
    """(C,) share of the foam that is left on each cell; None without foam"""


@dataclass(frozen=True, kw_only=True)
class Picturing:
    """What all frames of a video have in common. It can be pickled."""

    model: mujoco.MjModel
    """a film's (``film.skin.film_scene``)"""
    skin: FilmSkin
    """of that model"""
    foam: FoamPatch | None
    view: ViewAt
    inset: ViewAt | None
    """View of the small picture of the room; None draws none."""
    story: Story | None
    """What the charts beside the picture show; None draws none."""
    grid: SkinGrid | None
    size: tuple[int, int]
    """(width, height) of the picture without the charts [px]"""
    shadows: bool


class Painter:
    """Draws frames. Use it as a context manager, because it holds a renderer, which belongs to this process."""

    def __init__(self, what: Picturing) -> None:
        """Raises DependencyError where nothing can be rendered."""
        self._what = what
        self._data = mujoco.MjData(what.model)
        self._panels: dict[Kind, Panel] = {}
        self._foam_left: npt.NDArray[np.float64] | None = None
        self._stage = Stage(what.model, what.skin, width=what.size[0], height=what.size[1])

    def __enter__(self) -> Painter:
        return self

    def __exit__(self, *_: object) -> None:
        self._stage.__exit__()

    def frames(self, moments: Sequence[Moment]) -> list[Picture]:
        """(height, width, 3) for each moment. All of them have the small picture of the first one."""
        inset = None
        if self._what.inset is not None and self._what.story is not None:
            self._move_to(moments[0])
            inset = self._stage.picture(self._data, replace(self._what.inset(moments[0].time_s), radius_m=0.0), INSET)
        return [self._frame(moment, inset) for moment in moments]

    def _frame(self, moment: Moment, inset: Picture | None) -> Picture:
        what, view = self._what, self._what.view(moment.time_s)
        self._move_to(moment)
        view = view if what.shadows else replace(view, radius_m=0.0)
        picture = self._stage.picture(self._data, view, what.size, grid=what.grid)
        if what.story is None:
            return picture
        if inset is not None:
            height, width = inset.shape[:2]
            x, y = 20, picture.shape[0] - height - 20
            box(picture, x - 2, y - 2, x + width + 2, y + height + 2, PAPER)
            picture[y : y + height, x : x + width] = inset
        _write_events(picture, what.story.events, moment.time_s)
        if moment.kind not in self._panels:
            self._panels[moment.kind] = Panel(what.story, note=KIND_TEXTS[moment.kind])
        return np.hstack([picture, self._panels[moment.kind].at(moment.time_s)])

    def _move_to(self, moment: Moment) -> None:
        model, foam, left = self._what.model, self._what.foam, moment.foam_left
        if foam is not None and left is not None and (self._foam_left is None or (left != self._foam_left).any()):
            foam.paint(model, left)
            self._stage.skin_changed()
            self._foam_left = left
        mujoco.mj_setState(model, self._data, moment.state, STATE)
        mujoco.mj_kinematics(model, self._data)
        mujoco.mj_camlight(model, self._data)


def _write_events(picture: Picture, events: list[Event], time_s: float) -> None:
    """One under the other where several came shortly after each other."""
    now = [event for event in events if event.time_s <= time_s < event.time_s + EVENT_S and event.text != "start"]
    for row, event in enumerate(now):
        top = 20 + 42 * row
        width = round(text_width(event.text, 17, bold=True)) + 28
        faded(picture, 20, top, 20 + width, top + 38, (24, 26, 30), 0.72)
        write(picture, 34, top + 25, event.text, 17, colour=PAPER, bold=True)


AHEAD = 2
"""Number of batches that wait for each process, at most: enough that none idles, and few pictures in memory."""
THREADS = "LP_NUM_THREADS"
"""Environment variable with the number of threads of Mesa's software renderer; 0 draws in the calling thread."""

_what: Picturing | None = None
"""What all frames have in common, in a drawing process."""


@contextmanager
def drawing_processes(
    jobs: int, initializer: Callable[..., None], *arguments: object, killed: str
) -> Generator[ProcessPoolExecutor]:
    """Spawned processes: a forked one would wait for ever once this one has rendered. Raises DependencyError where one
    was killed."""
    pool = ProcessPoolExecutor(jobs, mp_context=get_context("spawn"), initializer=initializer, initargs=arguments)
    try:
        yield pool
    except BrokenProcessPool:
        raise DependencyError(killed) from None
    finally:
        pool.shutdown(cancel_futures=True)


def begin_drawing() -> None:
    # An interruption ends the process that waits for these, which then ends them.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.environ.setdefault(THREADS, "0")


def _begin(sent: bytes) -> None:
    global _what
    begin_drawing()
    plugin.load_plugins()  # without which a model with soft tissue cannot be unpacked
    _what = pickle.loads(sent)


@cache
def _painter() -> Painter:
    assert _what is not None
    return Painter(_what)


def _draw(batch: list[Moment]) -> list[Picture]:
    return _painter().frames(batch)


SIZE = (1280, 720)
"""(width, height) of a video [px]"""
PICTURE = (SIZE[0] - PANEL_WIDTH, PANEL_HEIGHT)
INSET_CAMERA = "exterior"
INSET_HZ = 5.0
"""How often the small picture of the room is drawn again: it costs a fifth of a frame, and shows little motion."""


class Film:
    """The video of one trial. Iterate over ``frames`` once."""

    def __init__(
        self,
        recording: Recording,
        *,
        view: str = CONTACT,
        fps: float = 12.5,
        grid: bool = True,
        shadows: bool = True,
        panel: bool = True,
        size: tuple[int, int] = PICTURE,
    ) -> None:
        """
        Args:
            view: a name of ``views.view_names``.
            fps: frames in a second of the trial.
            grid: whether lines on the region's skin show how it gives way.
            shadows: whether the picture has shadows, which cost a third of its time.
            panel: whether the charts stand beside the picture.
            size: (width, height) of the picture without the charts [px].

        Raises:
            ConfigError: no such view.
            RecordingError: the recording cannot be shown.
        """
        spec = recording.header.spec.opened
        check_view(view, spec.protocol)
        self._fps = fps
        self.replay = Replay(recording)
        region = spec.protocol.task(spec.task_id).region
        scene = film_scene(self.replay.scene, region)
        randomize_appearance(scene, spec.seed, salt=spec.salt)
        set_place(scene, scene.place)
        skin = FilmSkin(scene)
        near = clear_view(recording, scene.model, skin) if view == CONTACT else None
        self.view: ViewAt = view_of(view, recording) if near is None else Camera(view=near)
        """The camera at each time."""
        inset = panel and view != INSET_CAMERA and INSET_CAMERA in spec.protocol.cameras
        self._what = Picturing(
            model=scene.model, skin=skin, foam=scene.foam, view=self.view, size=size, shadows=shadows,
            inset=view_of(INSET_CAMERA, recording) if inset else None,
            story=story_of(recording) if panel else None,
            grid=SkinGrid(scene, region) if grid and region in scene.regions else None,
        )  # fmt: skip
        self.found = ReplayQuality()

    @property
    def count(self) -> int:
        """Number of frames."""
        return int(self.replay.step_count * self.replay.dt_s * self._fps + 1e-9) + 1

    def frames(self, begin_s: float = 0.0, end_s: float = np.inf, *, jobs: int = 1) -> Generator[Picture, None, None]:
        """Yield a picture for each frame between two times, drawn in ``jobs`` processes or in this one. Raises
        DependencyError where nothing can be rendered, or one of them was killed."""
        what, batches = replace(self._what, view=self.view), self._batches(begin_s, end_s)
        if jobs == 1:
            with Painter(what) as painter:
                for batch in batches:
                    yield from painter.frames(batch)
            return
        killed = "a process that draws the video was killed, perhaps for memory: try again with --jobs 1"
        waiting: deque[Future[list[Picture]]] = deque()
        with drawing_processes(jobs, _begin, pickle.dumps(what), killed=killed) as pool:
            for batch in batches:
                waiting.append(pool.submit(_draw, batch))
                if len(waiting) >= AHEAD * jobs:
                    yield from waiting.popleft().result()
            while waiting:
                yield from waiting.popleft().result()

    def _batches(self, begin_s: float, end_s: float) -> Iterator[list[Moment]]:
        """Frames with one small picture of the room in common."""
        wiping = RecordedWiping.of(self.replay.recording)
        for stretch in self.replay.stretches(self._fps):
            self.found.take(stretch)
            moments: list[Moment] = []
            for step, state in zip(stretch.steps, stretch.states, strict=True):
                time_s = float(step) * self.replay.dt_s
                left = None if wiping is None else wiping.until(time_s).left
                moments.append(Moment(time_s=time_s, state=state, kind=stretch.kind, foam_left=left))
            shown = [moment for moment in moments if begin_s <= moment.time_s <= end_s]
            for _, batch in groupby(shown, key=lambda moment: int(moment.time_s * INSET_HZ + 1e-6)):
                yield list(batch)


PRESET, QUALITY = "veryfast", "18"
"""Settings of x264: a constant quality at which text stays sharp."""
PART = ".part"
"""Ending of the name of a file that is still being written."""


def pyav() -> Any:
    """Raises DependencyError where the extra is not installed."""
    try:
        return import_module("av")
    except ModuleNotFoundError:
        raise DependencyError("a video needs PyAV: pip install 'carecontact[viz]'") from None


def write_mp4(
    path: Path,
    frames: Iterable[Picture],
    *,
    fps: float,
    comment: Callable[[], str] | str,
    more: Mapping[str, str] | None = None,
) -> None:
    """Write a video of frames of one size with even sides, whole or not at all; ``comment_of`` finds the comment."""
    av, part = pyav(), path.with_name(path.name + PART)
    rate = Fraction(fps).limit_denominator(1000)
    try:
        with av.open(str(part), "w", format="mp4", options={"movflags": "faststart"}) as file:
            stream: Any = None
            file.metadata["comment"] = comment if isinstance(comment, str) else comment()
            for picture in frames:
                if stream is None:
                    stream = file.add_stream(
                        "libx264", rate=rate, options={"preset": PRESET, "crf": QUALITY, **(more or {})}
                    )
                    stream.height, stream.width = picture.shape[:2]
                    stream.pix_fmt = "yuv420p"
                file.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
            if stream is not None:
                file.mux(stream.encode())
        os.replace(part, path)
    finally:
        part.unlink(missing_ok=True)


def comment_of(path: Path) -> str | None:
    """Return the comment that a video was written with; None for no video or an unreadable one."""
    av = pyav()
    try:
        with av.open(str(path)) as file:
            return file.metadata.get("comment")
    except (OSError, av.error.FFmpegError):
        return None


def write_gif(path: Path, frames: Iterable[Picture], *, fps: float, colours: int = 128) -> None:
    """Write a looping animation with one palette. Raises RecordingError where there is no frame."""
    pictures = [Image.fromarray(frame) for frame in frames]
    if not pictures:
        raise RecordingError(f"{path}: no frame to write")
    few = pictures[:: max(1, len(pictures) // 8)]
    sheet = Image.fromarray(np.vstack([np.asarray(picture) for picture in few]))
    palette = sheet.quantize(colours, method=Image.Quantize.MEDIANCUT)
    reduced = [picture.quantize(palette=palette, dither=Image.Dither.NONE) for picture in pictures]
    part = path.with_name(path.name + PART)
    reduced[0].save(
        part, format="GIF", save_all=True, append_images=reduced[1:], duration=round(1000 / fps), loop=0, optimize=True
    )
    os.replace(part, path)

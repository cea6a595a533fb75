"""The frames of a video: the world as one or two cameras see it, with charts beside it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import mujoco
import numpy as np
import numpy.typing as npt

from carecontact.episode.randomization import dress, lay
from carecontact.recording.schema import Recording
from carecontact.replaying.film.grid import SkinGrid
from carecontact.replaying.film.ink import PAPER, Picture, box, faded, text_width, write
from carecontact.replaying.film.panel import HEIGHT as PANEL_HEIGHT
from carecontact.replaying.film.panel import WIDTH as PANEL_WIDTH
from carecontact.replaying.film.panel import Panel
from carecontact.replaying.film.skin import film_scene
from carecontact.replaying.film.stage import Stage
from carecontact.replaying.film.story import Story, story_of
from carecontact.replaying.film.views import CONTACT, ViewAt, view_of
from carecontact.replaying.replay import SAID, STATE, Found, Kind, Replay
from carecontact.reports.trial.events import Event

SIZE = (1280, 720)
PICTURE = (SIZE[0] - PANEL_WIDTH, PANEL_HEIGHT)
INSET = (268, 151)
INSET_CAMERA = "exterior"
EVENT_S = 1.6
"""Time for which the picture shows the text of an event [s]."""
LAMPS = 2


class Film:
    """The video of one trial. Iterate over ``frames`` once. Use it as a context manager, because it holds a
    renderer."""

    def __init__(
        self,
        recording: Recording,
        *,
        view: str | ViewAt = CONTACT,
        fps: float = 25.0,
        grid: bool = True,
        lamps: int = LAMPS,
        panel: bool = True,
        size: tuple[int, int] | None = None,
    ) -> None:
        """
        Args:
            view: a name of ``views.view_names``, or where the camera is at each time.
            grid: whether lines on the region's skin show how it gives way.
            lamps: see ``Stage``.
            panel: whether the charts stand beside the picture.
            size: (width, height) of the picture without the charts [px].

        Raises:
            ConfigError: no such view.
            RecordingError: the recording cannot be shown.
            DependencyError: nothing can be rendered here.
        """
        self._view, self._fps = view_of(view, recording) if isinstance(view, str) else view, fps
        self.replay = Replay(recording)
        spec = recording.header.spec
        region = spec.protocol.task(spec.task_id).region
        scene = film_scene(self.replay.scene, region)
        dress(scene, spec.seed)
        lay(scene, scene.place)
        self._model, self._data = scene.model, mujoco.MjData(scene.model)
        self.story: Story | None = story_of(recording) if panel else None
        self._size = size or PICTURE
        inset = panel and view != INSET_CAMERA and INSET_CAMERA in spec.protocol.cameras
        self._inset = view_of(INSET_CAMERA, recording) if inset else None
        self._grid = SkinGrid(scene, region) if grid and region in scene.regions else None
        self._panels: dict[Kind, Panel] = {}
        self._stage = Stage(scene, width=self._size[0], height=self._size[1], lamps=lamps)
        self.found = Found()

    @property
    def count(self) -> int:
        """Number of frames."""
        return int(self.replay.step_count * self.replay.dt_s * self._fps + 1e-9) + 1

    def __enter__(self) -> Film:
        return self

    def __exit__(self, *_: object) -> None:
        self._stage.__exit__()

    def frames(self, begin_s: float = 0.0, end_s: float = np.inf) -> Iterator[Picture]:
        """(height, width, 3) between two times, by default of the whole trial."""
        for stretch in self.replay.stretches(self._fps):
            self.found.take(stretch)
            for step, state in zip(stretch.steps, stretch.states, strict=True):
                time_s = float(step) * self.replay.dt_s
                if begin_s <= time_s <= end_s:
                    yield self._frame(time_s, state, stretch.kind)

    def _frame(self, time_s: float, state: npt.NDArray[np.float64], kind: Kind) -> Picture:
        mujoco.mj_setState(self._model, self._data, state, STATE)
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_camlight(self._model, self._data)
        picture = self._stage.picture(self._data, self._view(time_s), self._size, grid=self._grid)
        if self.story is None:
            return picture
        if self._inset is not None:
            small = replace(self._inset(time_s), radius_m=0.0)
            _put_inset(picture, self._stage.picture(self._data, small, INSET))
        _write_events(picture, self.story.events, time_s)
        if kind not in self._panels:
            self._panels[kind] = Panel(self.story, note=SAID[kind])
        return np.hstack([picture, self._panels[kind].at(time_s)])


def _put_inset(picture: Picture, inset: Picture) -> None:
    height, width = inset.shape[:2]
    x, y = 20, picture.shape[0] - height - 20
    box(picture, x - 2, y - 2, x + width + 2, y + height + 2, PAPER)
    picture[y : y + height, x : x + width] = inset


def _write_events(picture: Picture, events: list[Event], time_s: float) -> None:
    """One under the other where several came shortly after each other."""
    now = [event for event in events if event.time_s <= time_s < event.time_s + EVENT_S and event.text != "start"]
    for row, event in enumerate(now):
        top = 20 + 42 * row
        width = round(text_width(event.text, 17, bold=True)) + 28
        faded(picture, 20, top, 20 + width, top + 38, (24, 26, 30), 0.72)
        write(picture, 34, top + 25, event.text, 17, colour=PAPER, bold=True)

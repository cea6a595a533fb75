"""A recorded trial as a video: its states, its view, and its frames."""

from __future__ import annotations

from collections.abc import Generator, Iterator
from dataclasses import replace
from itertools import groupby

import numpy as np

from carecontact.episode.randomization import dress, lay
from carecontact.recording.schema import Recording
from carecontact.replaying.film.clear_view import clear_view
from carecontact.replaying.film.grid import SkinGrid
from carecontact.replaying.film.helpers import drawn
from carecontact.replaying.film.ink import Picture
from carecontact.replaying.film.painter import Moment, Picturing
from carecontact.replaying.film.panel import HEIGHT as PANEL_HEIGHT
from carecontact.replaying.film.panel import WIDTH as PANEL_WIDTH
from carecontact.replaying.film.skin import FilmSkin, film_scene
from carecontact.replaying.film.story import story_of
from carecontact.replaying.film.views import CONTACT, Camera, ViewAt, check_view, view_of
from carecontact.replaying.replay import Found, Replay

SIZE = (1280, 720)
"""(width, height) of a video [px]"""
PICTURE = (SIZE[0] - PANEL_WIDTH, PANEL_HEIGHT)
INSET_CAMERA = "exterior"
INSET_HZ = 5.0
"""How often the small picture of the room is drawn anew: it costs a fifth of a frame, and shows little motion."""


class Film:
    """The video of one trial. Iterate over ``frames`` once."""

    def __init__(
        self,
        recording: Recording,
        *,
        view: str = CONTACT,
        fps: float = 25.0,
        grid: bool = True,
        shadows: bool = True,
        lamps: int = 1,
        panel: bool = True,
        size: tuple[int, int] = PICTURE,
    ) -> None:
        """
        Args:
            view: a name of ``views.view_names``.
            fps: frames in a second of the trial.
            grid: whether lines on the region's skin show how it gives way.
            shadows: whether the picture has shadows, which cost more than half of its time.
            lamps: see ``Stage``.
            panel: whether the charts stand beside the picture.
            size: (width, height) of the picture without the charts [px].

        Raises:
            ConfigError: no such view.
            RecordingError: the recording cannot be shown.
        """
        spec = recording.header.spec
        check_view(view, spec.protocol)
        self._fps = fps
        self.replay = Replay(recording)
        region = spec.protocol.task(spec.task_id).region
        scene = film_scene(self.replay.scene, region)
        dress(scene, spec.seed)
        lay(scene, scene.place)
        skin = FilmSkin(scene)
        near = clear_view(recording, scene.model, skin) if view == CONTACT else None
        self.view: ViewAt = view_of(view, recording) if near is None else Camera(view=near)
        """The camera at each time."""
        inset = panel and view != INSET_CAMERA and INSET_CAMERA in spec.protocol.cameras
        self._what = Picturing(
            model=scene.model, skin=skin, view=self.view, size=size, lamps=lamps, shadows=shadows,
            inset=view_of(INSET_CAMERA, recording) if inset else None,
            story=story_of(recording) if panel else None,
            grid=SkinGrid(scene, region) if grid and region in scene.regions else None,
        )  # fmt: skip
        self.found = Found()

    @property
    def count(self) -> int:
        """Number of frames."""
        return int(self.replay.step_count * self.replay.dt_s * self._fps + 1e-9) + 1

    def frames(self, begin_s: float = 0.0, end_s: float = np.inf, *, jobs: int = 1) -> Generator[Picture, None, None]:
        """Yield a picture (height, width, 3) for each frame between two times, by default of the whole trial.

        Args:
            jobs: number of processes that draw. The pictures do not depend on it.

        Raises:
            DependencyError: nothing can be rendered here.
        """
        yield from drawn(replace(self._what, view=self.view), self._batches(begin_s, end_s), jobs=jobs)

    def _batches(self, begin_s: float, end_s: float) -> Iterator[list[Moment]]:
        """Frames with one small picture of the room in common."""
        for stretch in self.replay.stretches(self._fps):
            self.found.take(stretch)
            moments = [
                Moment(time_s=float(step) * self.replay.dt_s, state=state, kind=stretch.kind)
                for step, state in zip(stretch.steps, stretch.states, strict=True)
            ]
            shown = [moment for moment in moments if begin_s <= moment.time_s <= end_s]
            for _, batch in groupby(shown, key=lambda moment: int(moment.time_s * INSET_HZ + 1e-6)):
                yield list(batch)

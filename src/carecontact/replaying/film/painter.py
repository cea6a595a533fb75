"""Draws the frames of a video: the world as one or two cameras see it, with charts beside it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np
import numpy.typing as npt

from carecontact.replaying.film.grid import SkinGrid
from carecontact.replaying.film.ink import PAPER, Picture, box, faded, text_width, write
from carecontact.replaying.film.panel import Panel
from carecontact.replaying.film.skin import FilmSkin
from carecontact.replaying.film.stage import Stage
from carecontact.replaying.film.story import Story
from carecontact.replaying.film.views import ViewAt
from carecontact.replaying.replay import SAID, STATE, Kind
from carecontact.reports.trial.events import Event

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


@dataclass(frozen=True, kw_only=True)
class Picturing:
    """What all frames of a video have in common. It can be pickled."""

    model: mujoco.MjModel
    """a film's (``film.skin.film_scene``)"""
    skin: FilmSkin
    """of that model"""
    view: ViewAt
    inset: ViewAt | None
    """View of the small picture of the room; None draws none."""
    story: Story | None
    """What the charts beside the picture show; None draws none."""
    grid: SkinGrid | None
    size: tuple[int, int]
    """(width, height) of the picture without the charts [px]"""
    lamps: int
    """see ``Stage``"""
    shadows: bool


class Painter:
    """Draws frames. Use it as a context manager, because it holds a renderer, which belongs to this process."""

    def __init__(self, what: Picturing) -> None:
        """Raises DependencyError where nothing can be rendered."""
        self._what = what
        self._data = mujoco.MjData(what.model)
        self._panels: dict[Kind, Panel] = {}
        self._stage = Stage(what.model, what.skin, width=what.size[0], height=what.size[1], lamps=what.lamps)

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
            _put_inset(picture, inset)
        _write_events(picture, what.story.events, moment.time_s)
        if moment.kind not in self._panels:
            self._panels[moment.kind] = Panel(what.story, note=SAID[moment.kind])
        return np.hstack([picture, self._panels[moment.kind].at(moment.time_s)])

    def _move_to(self, moment: Moment) -> None:
        model = self._what.model
        mujoco.mj_setState(model, self._data, moment.state, STATE)
        mujoco.mj_kinematics(model, self._data)
        mujoco.mj_camlight(model, self._data)


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

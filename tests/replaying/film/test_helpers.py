"""Several processes that draw one video."""

from __future__ import annotations

import os

import numpy as np
import pytest

from carecontact.errors import DependencyError
from carecontact.recording import Recording
from carecontact.replaying.film.frames import INSET_HZ, Film
from carecontact.replaying.film.stage import View

SMALL = (160, 90)


def test_the_pictures_do_not_depend_on_the_number_of_processes(pressed: Recording) -> None:
    one, two = (list(Film(pressed, fps=4, size=SMALL, panel=False).frames(1.9, 2.8, jobs=jobs)) for jobs in (1, 2))
    assert len(one) == len(two) > 2
    for a, b in zip(one, two, strict=True):
        np.testing.assert_array_equal(a, b)
    assert any((a != one[0]).any() for a in one), "the pictures differ, so that their order shows"

    bare = Film(pressed, fps=4, size=SMALL, panel=False, shadows=False).frames(1.9, 2.8)
    assert (next(bare).astype(int) - one[0]).max() > 30, "without shadows, some places are brighter"


def test_a_batch_has_one_small_picture_of_the_room(pressed: Recording) -> None:
    film = Film(pressed, fps=50, size=SMALL)
    batches = list(film._batches(0.0, np.inf))
    assert sum(map(len, batches)) == film.count
    assert max(batch[-1].time_s - batch[0].time_s for batch in batches) < 1 / INSET_HZ
    assert max(map(len, batches)) > 5


class Killed:
    def __call__(self, time_s: float) -> View:
        os._exit(9)


def test_a_drawing_process_that_is_killed_is_told(pressed: Recording) -> None:
    film = Film(pressed, fps=4, size=SMALL, panel=False)
    film.view = Killed()
    with pytest.raises(DependencyError, match=r"was killed.*--jobs 1"):
        list(film.frames(jobs=2))

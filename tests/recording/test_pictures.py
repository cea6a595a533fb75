"""Pictures go into a recording and come out bit for bit, whatever they show and however many there are."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from carecontact.errors import RecordingError
from carecontact.recording import Recording, read_recording, write_recording
from carecontact.recording import pictures as module
from carecontact.recording.pictures import FILM, MAX_FRAMES, PictureLog, Pictures
from tests.scoring.synthetic import touch

FILM_OF = f"{FILM}overhead/rgb"


def taken(count: int, *, seed: int = 0) -> list[tuple[int, str, str, npt.NDArray[Any]]]:
    """Colour and depth of two cameras at every third observation; random pixels change from picture to picture."""
    rng, out = np.random.default_rng(seed), []
    sizes = {"overhead": (5, 7), "wrist": (4, 6)}
    rgb = {name: rng.integers(0, 256, (*size, 3), np.uint8) for name, size in sizes.items()}
    for k in range(count):
        for name, size in sizes.items():
            rgb[name] = np.where(rng.random((*size, 1)) < 0.2, rng.integers(0, 256, (*size, 3), np.uint8), rgb[name])
            depth = rng.normal(1, 0.1, size).astype(np.float32)
            depth[rng.random(size) < 0.2] = np.nan
            out += [(3 * k, name, "rgb", rgb[name]), (3 * k, name, "depth", depth)]
    return out


def recorded(shown: list[tuple[int, str, str, npt.NDArray[Any]]]) -> Recording:
    log = PictureLog()
    for picture in shown:
        log.add(*picture)
    bare = touch(seed=0)
    return replace(bare, arrays={**bare.arrays, **log.arrays()})


def test_every_picture_comes_back_bit_for_bit_from_a_file(tmp_path: Path) -> None:
    shown = taken(40)
    assert len(shown) > 2 * MAX_FRAMES
    found = Pictures(read_recording(write_recording(recorded(shown), tmp_path / "trial.h5")))
    assert len(found) == len(shown)
    # In any order: backwards, a film begins again.
    for index, camera, modality, picture in [*shown, *reversed(shown)]:
        again = found[index, camera, modality]
        assert (again.dtype, again.shape) == (picture.dtype, picture.shape)
        assert again.tobytes() == picture.tobytes()


def test_pictures_are_in_the_order_of_their_observations_with_colour_first() -> None:
    keys = list(Pictures(recorded(taken(20))))
    assert [index for index, _, _ in keys] == sorted(3 * (k // 4) for k in range(80))
    assert [key[1:] for key in keys[-4:]] == [
        *(("overhead", "rgb"), ("wrist", "rgb")), *(("overhead", "depth"), ("wrist", "depth"))
    ]  # fmt: skip


def test_the_first_pictures_of_a_trial_stay_as_they_are() -> None:
    few, many = recorded(taken(MAX_FRAMES // 4)), recorded(taken(MAX_FRAMES // 4 + 1))
    assert not [path for path in few.arrays if path.startswith(FILM)]
    assert [path for path in many.arrays if not path.startswith(FILM)] == list(few.arrays)
    assert len([path for path in many.arrays if path.endswith("/data")]) == 4


def test_a_room_that_stands_still_takes_almost_nothing() -> None:
    still = np.random.default_rng(0).integers(0, 256, (120, 160, 3), np.uint8)
    film = recorded([(k, "overhead", "rgb", still) for k in range(MAX_FRAMES + 100)])
    first, *later = np.diff(film[f"{FILM_OF}/end"], prepend=0).tolist()
    assert first > still.nbytes * 0.9
    assert max(later) < still.nbytes / 200


def test_pictures_beyond_the_bound_are_not_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MAX_FILM_BYTES", 2000)
    shown = taken(60)
    found = Pictures(recorded(shown))
    assert MAX_FRAMES < len(found) < len(shown)
    assert list(found) == list(Pictures(recorded(shown[: len(found)])))


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("data", lambda a: a[: len(a) // 2], "damaged|does not have"),
        ("data", lambda a: a ^ 0x55, "damaged"),
        ("shape", lambda a: a * 2, "does not have"),
        ("shape", lambda a: np.array([1 << 20, 1 << 20, 3], a.dtype), "which no picture has"),
        ("shape", lambda a: np.array([-5, -7, 3], a.dtype), "which no picture has"),
        ("end", lambda a: a.astype(float), "whole numbers"),
        ("end", lambda a: a[:1], "damaged"),
        ("observation_index", lambda a: a.reshape(1, -1), "whole numbers"),
    ],
)
def test_a_damaged_film_is_named(name: str, change: Any, message: str) -> None:
    whole = recorded(taken(30))
    damaged = replace(whole, arrays={**whole.arrays, f"{FILM_OF}/{name}": change(whole[f"{FILM_OF}/{name}"])})
    with pytest.raises(RecordingError, match=rf"T1-s000: {FILM_OF}.*({message})"):
        list(Pictures(damaged).values())


def test_a_picture_that_claims_to_be_larger_than_its_size_is_not_unpacked() -> None:
    import zlib

    whole = recorded(taken(30))
    bomb = np.frombuffer(zlib.compress(bytes(1 << 24)), np.uint8)
    arrays = {**whole.arrays, f"{FILM_OF}/data": bomb, f"{FILM_OF}/end": np.full(14, len(bomb), np.int64)}
    with pytest.raises(RecordingError, match="does not have"):
        list(Pictures(replace(whole, arrays=arrays)).values())

"""The pictures that a policy was sent: the first ones of a trial as they are, all later ones as films without loss.

A film holds the pictures of one camera and modality, each as what changed since the one before it: every byte minus the
byte there in the picture before, modulo 256, compressed with zlib. Most of a room stands still, so that a colour
picture of 640 x 480 takes 18 kB overhead and 91 kB on the hand, where PNG takes 81 and 56 kB and eight times as long
(a scrub at 10 Hz). The bytes of the four-byte numbers of a depth image are sorted by their place in the number first.

The bytes of a film depend on the library that compressed them, and the pictures do not.
"""

from __future__ import annotations

import re
import zlib
from collections.abc import Iterator, Mapping
from typing import Any, Literal, get_args

import numpy as np
import numpy.typing as npt

from carecontact.errors import RecordingError
from carecontact.recording.schema import Recording

Kept = Literal["rgb", "depth"]
KEPT: tuple[str, ...] = get_args(Kept)
"""Modalities of which a recording keeps the pictures."""
DTYPES = {"rgb": "|u1", "depth": "<f4"}
FRAMES, FILM = "policy/frames/", "policy/film/"
MAX_FRAMES = 64
"""Number of pictures of a trial that are kept as they are."""
MAX_FILM_BYTES = 512 << 20
"""Most bytes of all films of a trial, half of what a recording may have: 48 minutes of a colour camera at 10 Hz
overhead, or ten minutes of one on the hand. Later pictures are not kept."""
MAX_PICTURE_BYTES = 256 << 20
"""Largest size of one picture of a film, which a damaged file might claim."""
FAST = 1
"""Level of zlib: level 6 takes twice as long for films that are a quarter smaller."""
_FRAME = re.compile(r"policy/frames/([0-9]{1,9})/([^/]+)/(rgb|depth)")
_FILM = re.compile(r"policy/film/([^/]+)/(rgb|depth)/data")

Key = tuple[int, str, str]
"""Index of the observation, camera, modality."""
Bytes = npt.NDArray[np.uint8]


class PictureLog:
    """Collects the pictures of one trial."""

    def __init__(self) -> None:
        self._frames: dict[str, npt.NDArray[Any]] = {}
        self._films: dict[str, _Film] = {}
        self._bytes = 0

    def add(self, index: int, camera: str, modality: str, picture: npt.NDArray[Any]) -> None:
        """Add a picture: of one camera and modality, all have the same size. ``index``: of its observation."""
        if len(self._frames) < MAX_FRAMES:
            self._frames[f"{FRAMES}{index:04d}/{camera}/{modality}"] = picture
        elif self._bytes < MAX_FILM_BYTES:
            film = self._films.setdefault(f"{FILM}{camera}/{modality}", _Film())
            self._bytes += film.add(index, np.ascontiguousarray(picture, DTYPES[modality]))

    def arrays(self) -> dict[str, npt.NDArray[Any]]:
        """Return the arrays of a recording by their path."""
        return self._frames | {f"{path}/{name}": a for path, film in self._films.items() for name, a in film.arrays()}


class _Film:
    def __init__(self) -> None:
        self._before: Bytes | None = None
        self._shape: tuple[int, ...] = ()
        self._parts: list[bytes] = []
        self._indices: list[int] = []

    def add(self, index: int, picture: npt.NDArray[Any]) -> int:
        """Return the number of bytes that the picture takes."""
        # The bytes of the picture, first those of the lowest place in each number.
        planes = np.ascontiguousarray(picture.reshape(-1).view(np.uint8).reshape(-1, picture.itemsize).T).reshape(-1)
        changed = planes if self._before is None else planes - self._before
        self._before, self._shape = planes, picture.shape
        self._parts.append(zlib.compress(changed.data, FAST))
        self._indices.append(index)
        return len(self._parts[-1])

    def arrays(self) -> Iterator[tuple[str, npt.NDArray[Any]]]:
        yield "data", np.frombuffer(b"".join(self._parts), np.uint8)
        yield "end", np.cumsum([len(part) for part in self._parts]).astype("<i8")
        yield "observation_index", np.array(self._indices, "<i4")
        yield "shape", np.array(self._shape, "<i4")


class Pictures(Mapping[Key, npt.NDArray[Any]]):
    """The pictures by observation, colour before depth. Raises RecordingError for a damaged film."""

    def __init__(self, recording: Recording) -> None:
        self._recording, self._title = recording, recording.header.spec.trial_id
        found: dict[Key, str] = {}
        self._place: dict[Key, int] = {}
        """Key of a picture of a film -> its number in the film."""
        self._shown: dict[str, tuple[int, Bytes]] = {}
        """Film -> number and bytes of the picture that was made last."""
        for path in recording.arrays:
            if match := _FRAME.fullmatch(path):
                found[int(match[1]), match[2], match[3]] = path
            elif match := _FILM.fullmatch(path):
                film = path.removesuffix("/data")
                for number, index in enumerate(self._part(film, "observation_index").tolist()):
                    found[index, match[1], match[2]] = film
                    self._place[index, match[1], match[2]] = number
        self._paths = dict(sorted(found.items(), key=lambda item: (item[0][0], item[0][2] == "depth", item[0][1])))

    def __getitem__(self, key: Key) -> npt.NDArray[Any]:
        film = self._paths[key]
        if key not in self._place:
            return self._recording[film]
        number, dtype, shape = self._place[key], np.dtype(DTYPES[key[2]]), tuple(self._part(film, "shape").tolist())
        size = int(np.prod(shape, dtype=object)) * dtype.itemsize
        if not 0 < size <= MAX_PICTURE_BYTES or min(shape) < 0:
            raise RecordingError(f"{self._title}: {film}/shape is {shape}, which no picture has")
        at, planes = self._shown.get(film, (-1, np.zeros(size, np.uint8)))
        if at > number:
            at, planes = -1, np.zeros(size, np.uint8)
        for step in range(at + 1, number + 1):
            planes = planes + self._changed(film, step, size)
        self._shown[film] = number, planes
        return np.ascontiguousarray(planes.reshape(dtype.itemsize, -1).T).reshape(-1).view(dtype).reshape(shape)

    def __iter__(self) -> Iterator[Key]:
        return iter(self._paths)

    def __len__(self) -> int:
        return len(self._paths)

    def _changed(self, film: str, number: int, size: int) -> Bytes:
        end, data = self._part(film, "end"), self._recording[f"{film}/data"]
        begin = int(end[number - 1]) if number else 0
        unpacker = zlib.decompressobj()
        try:
            plain = unpacker.decompress(data[begin : int(end[number])].tobytes(), size + 1)
        except (zlib.error, IndexError) as error:
            raise RecordingError(f"{self._title}: {film}: picture {number} is damaged: {error}") from None
        if len(plain) != size:
            raise RecordingError(f"{self._title}: {film}: picture {number} does not have {size} bytes")
        return np.frombuffer(plain, np.uint8)

    def _part(self, film: str, name: str) -> npt.NDArray[Any]:
        part = self._recording.arrays.get(f"{film}/{name}")
        if part is None or part.dtype.kind != "i" or part.ndim != 1:
            raise RecordingError(f"{self._title}: {film}/{name}: expected a row of whole numbers")
        return part

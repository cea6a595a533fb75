"""Recordings as a dataset of LeRobot: one row for each action that the robot executed."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from carecontact.errors import ConfigError, DependencyError, RecordingError
from carecontact.interface.geometry import pose_matrix, quat_from_matrix
from carecontact.interface.policy import CAMERAS
from carecontact.pictures import png
from carecontact.recording.pictures import Pictures
from carecontact.recording.schema import Recording

F32 = npt.NDArray[np.float32]
LOOKED = "policy/looked"
POSE = ("x", "y", "z", "qw", "qx", "qy", "qz")
"""Names of a pose: position [m] and quaternion."""


@dataclass(frozen=True, kw_only=True)
class Stream:
    """The values of one quantity in every row of an episode."""

    names: tuple[str, ...]
    values: F32
    """(M, len(names))"""


@dataclass(frozen=True, kw_only=True)
class Episode:
    instruction: str
    fps: float
    """Number of rows in a second of simulated time, an int where it is whole."""
    streams: dict[str, Stream]
    images: Mapping[str, Sequence[npt.NDArray[np.uint8]]] = field(default_factory=dict[str, Any])
    """Camera -> (H, W, 3) images, in the order in which they were sent."""
    shown: Mapping[str, npt.NDArray[np.int64]] = field(default_factory=dict[str, Any])
    """Camera -> (M,) index of the image that the policy had when it chose the action."""

    def __len__(self) -> int:
        return len(self.streams["action"].values)


def episode_of(recording: Recording, *, force: bool = False) -> Episode:
    """Return the trial's episode. No quantity of the scorer is in it unless ``force`` asks for one.

    Args:
        force: adds ``scorer.force``, the norm of the robot's summed force on each body segment [N], which no policy
            receives.

    Raises RecordingError for a trial without an action, for one whose actions are not evenly spaced in time, and for
    one of which the recording does not hold every image that the policy was sent.
    """
    header = recording.header
    title = header.spec.trial_id
    if header.card is None or not len(recording["actions/time_s"]):
        raise RecordingError(f"{title}: the policy did no action")
    spec, card = header.spec, header.card
    index = recording["actions/observation_index"].astype(np.int64)
    streams = {"action": _action(recording)}
    if spec.protocol.variation.encoder_noise_rad == 0:
        streams["observation.state"] = Stream(names=POSE, values=_tool(recording))
    seen_s = recording["policy/observation_time_s"][index]
    age = (recording["actions/time_s"] - seen_s)[:, None].astype(np.float32)
    streams["observation.age_s"] = Stream(names=("age_s",), values=age)
    if force:
        rows = _steps(recording)
        norm = np.linalg.norm(recording["scorer/force_human_from_robot_in_world"][rows], axis=2)
        streams["scorer.force"] = Stream(names=tuple(header.segments), values=norm.astype(np.float32))
    cameras: list[str] = card["cameras"] if "rgb" in card["modalities"] else []
    taken = {camera: _taken(recording, camera)[index] for camera in cameras}
    if LOOKED in recording.arrays and cameras:
        seen = np.stack([recording["policy/observation_time_s"][taken[camera]] for camera in cameras], 1)
        age = (recording["actions/time_s"][:, None] - seen).astype(np.float32)
        streams["observation.view_age_s"] = Stream(names=tuple(cameras), values=age)
    pictures = Pictures(recording)
    for camera, at in taken.items():
        if absent := sorted({int(k) for k in at if (int(k), camera, "rgb") not in pictures}):
            raise RecordingError(
                f"{title}: the recording does not hold the image of {camera} at observation {absent[0]}"
            )
    return Episode(
        instruction=spec.protocol.task(spec.task_id).prompt,
        fps=_fps(recording, title),
        streams=streams,
        images={camera: _Images(pictures, camera, np.unique(at).tolist()) for camera, at in taken.items()},
        shown={camera: np.unique(at, return_inverse=True)[1] for camera, at in taken.items()},
    )


def _fps(recording: Recording, title: str) -> float:
    """Return the rate at which the recorded actions began.

    That is the card's control rate, or a lower one if every answer was a single action and came after a latency.
    """
    spec, times_s = recording.header.spec, recording["actions/time_s"]
    dt_s, hz = spec.protocol.physics.dt_s, float((recording.header.card or {})["control_hz"])
    wait_s = round(spec.protocol.phases.latency_s / dt_s) * dt_s
    for rate in (round(1 / (1 / hz + wait_s), 9), hz) if wait_s else (hz,):
        # A control period is a whole number of physics steps, and only its mean is exact.
        if np.abs(times_s - times_s[0] - np.arange(len(times_s)) / rate).max() < 1.5 * dt_s:
            return int(rate) if rate.is_integer() else rate
    apart_s = np.diff(times_s)
    raise RecordingError(
        f"{title}: its actions are {apart_s.min():.3g} to {apart_s.max():.3g} s apart, and a dataset has one rate; "
        "runs of policies that answer several actions at a time can be exported only without --latency-ms"
    )


def _action(recording: Recording) -> Stream:
    """Return the target of each action; where an action kept the last target, that one, and before any the tool's own
    pose."""
    if "actions/joint" in recording.arrays:
        joint = recording["actions/joint"]
        names = tuple(f"joint{k + 1}" for k in range(joint.shape[1]))
        return Stream(names=names, values=_filled(joint, np.zeros(len(names))))
    return Stream(names=POSE, values=_filled(recording["actions/pose_tcp_in_base"], _tool(recording)[0]))


def _filled(values: npt.NDArray[Any], before: npt.NDArray[Any]) -> F32:
    out = values.astype(np.float32)
    for row in range(len(out)):
        if np.isnan(out[row]).any():
            out[row] = out[row - 1] if row else before
    return out


def _steps(recording: Recording) -> npt.NDArray[np.int64]:
    """(M,) the physics step at which each action began."""
    steps = np.searchsorted(recording["scorer/time_s"], recording["actions/time_s"] - 1e-9)
    return np.clip(steps, 0, len(recording["scorer/time_s"]) - 1)


def _tool(recording: Recording) -> F32:
    """(M, 7) the tool's pose in the robot's base as its encoders tell it when each action begins."""
    base = recording.header.pose_base_in_world
    to_base = np.linalg.inv(pose_matrix(np.array(base[:3]), np.array(base[3:])))
    rows: list[npt.NDArray[Any]] = []
    for pose in recording["scorer/pose_tcp_in_world"][_steps(recording)].astype(float):
        matrix = to_base @ pose_matrix(pose[:3], pose[3:])
        quat = quat_from_matrix(matrix[:3, :3])
        # A quaternion and its negative are one rotation: keep the sign from row to row.
        if rows and float(quat @ rows[-1][3:]) < 0:
            quat = -quat
        rows.append(np.concatenate([matrix[:3, 3], quat]))
    return np.array(rows, np.float32)


def _taken(recording: Recording, camera: str) -> npt.NDArray[np.int64]:
    """(A,) for each observation the one whose view of the camera it held: the last one for which the camera took one.
    The first observation of a trial has a view of every camera."""
    own = np.arange(len(recording["policy/observation_time_s"]))
    if LOOKED not in recording.arrays:
        return own
    new = recording[LOOKED][:, CAMERAS.index(camera)] > 0
    return np.maximum.accumulate(np.where(new, own, 0))


class _Images(Sequence[npt.NDArray[np.uint8]]):
    """The colour images of a camera at some observations, each made when it is used."""

    def __init__(self, pictures: Pictures, camera: str, indices: list[int]) -> None:
        self._pictures, self._camera, self._indices = pictures, camera, indices

    def __len__(self) -> int:
        return len(self._indices)

    def __getitem__(self, at: Any) -> Any:
        return self._pictures[self._indices[at], self._camera, "rgb"]


Format = Literal["v3.0", "v2.1"]
FILES_IN_CHUNK = 1000
FILE = "chunk-{chunk_index:03d}/file-{file_index:03d}"
DATA_PATHS: dict[Format, str] = {
    "v3.0": f"data/{FILE}.parquet",
    "v2.1": "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet",
}
INDICES = ("timestamp", "frame_index", "episode_index", "index", "task_index")
"""Columns that every row has; the first is float32, the others are int64."""
QUANTILES = {"q01": 0.01, "q10": 0.1, "q50": 0.5, "q90": 0.9, "q99": 0.99}
IMAGE = "observation.images."


@dataclass(kw_only=True)
class Dataset:
    """A LeRobotDataset: parquet files of rows with images in them, and JSON beside. Format v3.0 is what lerobot reads
    since its release 0.4, v2.1 what openpi's trainer reads.

    It is written one episode at a time, each into a data file of its own; ``close`` writes the metadata. Images are PNG
    inside the rows, without loss.
    """

    folder: Path
    robot: str
    version: Format = "v3.0"
    _features: dict[str, Any] = field(default_factory=dict[str, Any])
    _fps: float = 0.0
    _tasks: list[str] = field(default_factory=list[str])
    _episodes: list[dict[str, Any]] = field(default_factory=list[dict[str, Any]])
    _episode_stats: list[dict[str, Any]] = field(default_factory=list[dict[str, Any]])
    _columns: dict[str, list[Any]] = field(default_factory=dict[str, list[Any]])
    _pixels: dict[str, Any] = field(default_factory=dict[str, Any])
    """Column of a camera -> histogram of all its rows so far, (3, 256)."""
    _rows: int = 0

    def add(self, episode: Episode, *, name: str) -> None:
        """Write one episode. ``name``: of the trial, for messages.

        Raises ConfigError if its streams, images or rate are not those of the episodes before.
        """
        found = features_of(episode)
        if not self._features:
            self._features, self._fps = found, episode.fps
        if found != self._features or episode.fps != self._fps:
            keys = sorted(found.keys() | self._features.keys())
            differing = ", ".join(key for key in keys if found.get(key) != self._features.get(key))
            what = differing or f"a rate of {episode.fps} Hz and not {self._fps} Hz"
            raise ConfigError(f"{name} cannot be in one dataset with the trials before it: it differs in {what}")
        if episode.instruction not in self._tasks:
            self._tasks.append(episode.instruction)
        number, length = len(self._episodes), len(episode)
        chunk, file = divmod(number, FILES_IN_CHUNK)
        place = {"chunk_index": chunk, "file_index": file, "episode_chunk": chunk, "episode_index": number}
        columns = {key: s.values for key, s in episode.streams.items()} | self._indices(episode, number)
        pixels = {
            IMAGE + camera: _histogram(images, episode.shown[camera]) for camera, images in episode.images.items()
        }
        features = {**self._features, **_INDEX_FEATURES}
        _write(self.folder / DATA_PATHS[self.version].format(**place), columns, _encoded(episode), features)
        for key, values in columns.items():
            self._columns.setdefault(key, []).append(values)
        for key, histogram in pixels.items():
            self._pixels[key] = self._pixels.get(key, 0) + histogram
        self._episodes.append({"episode_index": number, "tasks": [episode.instruction], "length": length})
        self._episode_stats.append(_stats(columns, pixels))
        self._rows += length

    def close(self) -> None:
        """Write the metadata. Raises ConfigError for a dataset without an episode."""
        if not self._episodes:
            raise ConfigError(f"{self.folder}: no trial could be exported, so there is no dataset")
        meta = self.folder / "meta"
        meta.mkdir(parents=True, exist_ok=True)
        (meta / "info.json").write_text(json.dumps(self._info(), indent=4) + "\n")
        if self.version == "v2.1":
            stats = [{"episode_index": k, "stats": found} for k, found in enumerate(self._episode_stats)]
            tasks = [{"task_index": k, "task": task} for k, task in enumerate(self._tasks)]
            for file, lines in (("episodes", self._episodes), ("episodes_stats", stats), ("tasks", tasks)):
                (meta / f"{file}.jsonl").write_text("".join(f"{json.dumps(line)}\n" for line in lines))
            return
        arrow, parquet = _pyarrow()
        whole = _stats({key: np.concatenate(parts) for key, parts in self._columns.items()}, self._pixels)
        (meta / "stats.json").write_text(json.dumps(whole, indent=4) + "\n")
        (meta / "episodes" / "chunk-000").mkdir(parents=True, exist_ok=True)
        parquet.write_table(
            arrow.Table.from_pylist(self._episode_rows()),
            meta / "episodes" / f"{FILE.format(chunk_index=0, file_index=0)}.parquet",
        )
        parquet.write_table(_task_table(self._tasks), meta / "tasks.parquet")

    def _episode_rows(self) -> list[dict[str, Any]]:
        """Return what v3.0 has of each episode. lerobot's tools compute the statistics of a changed dataset from the
        columns ``stats/FEATURE/NAME``."""
        rows: list[dict[str, Any]] = []
        begin = 0
        for episode, stats in zip(self._episodes, self._episode_stats, strict=True):
            chunk, file = divmod(episode["episode_index"], FILES_IN_CHUNK)
            end = begin + episode["length"]
            row = {**episode, "data/chunk_index": chunk, "data/file_index": file}
            row |= {"dataset_from_index": begin, "dataset_to_index": end}
            row |= {f"stats/{key}/{name}": v for key, found in stats.items() for name, v in found.items()}
            rows.append(row | {"meta/episodes/chunk_index": 0, "meta/episodes/file_index": 0})
            begin = end
        return rows

    def _indices(self, episode: Episode, number: int) -> dict[str, Any]:
        frames = np.arange(len(episode), dtype=np.int64)
        task = self._tasks.index(episode.instruction)
        return {
            "timestamp": (frames / episode.fps).astype(np.float32),
            "frame_index": frames,
            "episode_index": np.full(len(episode), number, np.int64),
            "index": frames + self._rows,
            "task_index": np.full(len(episode), task, np.int64),
        }

    def _info(self) -> dict[str, Any]:
        count = len(self._episodes)
        if self.version == "v2.1":
            own = {"total_videos": 0, "total_chunks": -(-count // FILES_IN_CHUNK)}
        else:
            own = {"data_files_size_in_mb": 100, "video_files_size_in_mb": 200}
        return {
            "codebase_version": self.version,
            "robot_type": self.robot,
            "total_episodes": count,
            "total_frames": self._rows,
            "total_tasks": len(self._tasks),
            "chunks_size": FILES_IN_CHUNK,
            **own,
            "fps": self._fps,
            "splits": {"train": f"0:{count}"},
            "data_path": DATA_PATHS[self.version],
            "video_path": None,
            "features": {**self._features, **_INDEX_FEATURES},
        }


_INDEX_FEATURES = {
    name: {"dtype": "float32" if name == "timestamp" else "int64", "shape": [1], "names": None} for name in INDICES
}


def features_of(episode: Episode) -> dict[str, Any]:
    """Name of each stream and camera -> its type, shape and names, as info.json has them."""
    features: dict[str, Any] = {
        key: {"dtype": "float32", "shape": [len(stream.names)], "names": list(stream.names)}
        for key, stream in episode.streams.items()
    }
    for camera, images in episode.images.items():
        shape = list(images[0].shape)
        features[IMAGE + camera] = {"dtype": "image", "shape": shape, "names": ["height", "width", "channels"]}
    return features


def _encoded(episode: Episode) -> dict[str, list[dict[str, Any]]]:
    """Camera's column -> the image of every row as PNG."""
    columns: dict[str, list[dict[str, Any]]] = {}
    for camera, images in episode.images.items():
        encoded = [{"bytes": png(image), "path": None} for image in images]
        columns[IMAGE + camera] = [encoded[k] for k in episode.shown[camera]]
    return columns


def _write(
    path: Path, columns: dict[str, Any], images: dict[str, list[dict[str, Any]]], features: dict[str, Any]
) -> None:
    arrow, parquet = _pyarrow()
    arrays: dict[str, Any] = {}
    for name, values in columns.items():
        flat = values.ndim == 1 or values.shape[1] == 1
        arrays[name] = arrow.array(values.reshape(-1) if flat else list(values))
    kind = arrow.struct([("bytes", arrow.binary()), ("path", arrow.string())])
    arrays |= {name: arrow.array(rows, type=kind) for name, rows in images.items()}
    # The library `datasets`, by which lerobot reads the file, learns from this which columns are images.
    kinds = {name: _kind(features[name]) for name in arrays}
    table = arrow.table(arrays).replace_schema_metadata({"huggingface": json.dumps({"info": {"features": kinds}})})
    path.parent.mkdir(parents=True, exist_ok=True)
    # Rows that show the same image share its bytes in a file whose dictionary has room for all of them.
    parquet.write_table(table, path, dictionary_pagesize_limit=1 << 30)


def _kind(feature: dict[str, Any]) -> dict[str, Any]:
    if feature["dtype"] == "image":
        return {"_type": "Image"}
    value = {"dtype": feature["dtype"], "_type": "Value"}
    return value if feature["shape"] == [1] else {"feature": value, "_type": "Sequence"}


def _task_table(names: list[str]) -> Any:
    """Texts of the tasks as the index of a pandas frame, which is what the reader expects."""
    arrow, _ = _pyarrow()
    index = "__index_level_0__"
    text = {"name": None, "field_name": index, "pandas_type": "unicode", "numpy_type": "object", "metadata": None}
    kinds = {"pandas_type": "int64", "numpy_type": "int64", "metadata": None}
    number = {"name": "task_index", "field_name": "task_index", **kinds}
    about = {"index_columns": [index], "column_indexes": [], "columns": [number, text], "pandas_version": "2.2.0"}
    table = arrow.table({"task_index": arrow.array(range(len(names)), type=arrow.int64()), index: names})
    return table.replace_schema_metadata({"pandas": json.dumps(about)})


def _stats(columns: dict[str, Any], pixels: dict[str, Any]) -> dict[str, Any]:
    """Statistics of every column of rows, in lerobot's shapes: a list of numbers, and (3, 1, 1) for an image in [0, 1].

    Args:
        columns: name -> (N, D) or (N,).
        pixels: column of a camera -> histogram of its rows (3, 256).
    """
    stats: dict[str, Any] = {}
    rows = len(columns["index"])
    for key, values in columns.items():
        numbers = np.asarray(values, float).reshape(rows, -1)
        found = {"min": numbers.min(0), "max": numbers.max(0), "mean": numbers.mean(0), "std": numbers.std(0)}
        found |= {name: np.quantile(numbers, q, axis=0) for name, q in QUANTILES.items()}
        stats[key] = {**{name: row.tolist() for name, row in found.items()}, "count": [rows]}
    levels = np.arange(256) / 255
    for key, histogram in pixels.items():
        mean = [np.average(levels, weights=channel) for channel in histogram]
        found = {
            "min": [levels[channel > 0].min() for channel in histogram],
            "max": [levels[channel > 0].max() for channel in histogram],
            "mean": mean,
            "std": [np.average((levels - m) ** 2, weights=c) ** 0.5 for m, c in zip(mean, histogram, strict=True)],
        }
        for name, q in QUANTILES.items():
            found[name] = [np.quantile(levels, q, weights=c, method="inverted_cdf") for c in histogram]
        stats[key] = {**{name: [[[float(v)]] for v in row] for name, row in found.items()}, "count": [rows]}
    return stats


def _histogram(images: Sequence[Any], shown: Any) -> Any:
    """(3, 256) how often each channel has each level, over all pixels of all rows."""
    total = np.zeros((3, 256), np.int64)
    for image, rows in zip(images, np.bincount(shown, minlength=len(images)), strict=True):
        total += rows * np.array([np.bincount(image[:, :, channel].ravel(), minlength=256) for channel in range(3)])
    return total


def _pyarrow() -> tuple[Any, Any]:
    try:
        return import_module("pyarrow"), import_module("pyarrow.parquet")
    except ModuleNotFoundError:
        raise DependencyError("a dataset needs pyarrow: pip install 'carecontact[tables]'") from None

"""Writes a LeRobotDataset: parquet files of rows, films or images, and JSON beside."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any, Literal

import numpy as np

from carecontact.errors import ConfigError, DependencyError
from carecontact.pictures import png
from carecontact.recording.lerobot import Episode, histogram_of

Format = Literal["v3.0", "v2.1"]
FILES_IN_CHUNK = 1000
FILE = "chunk-{chunk_index:03d}/file-{file_index:03d}"
DATA_PATHS: dict[Format, str] = {
    "v3.0": f"data/{FILE}.parquet",
    "v2.1": "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet",
}
VIDEO_PATH = f"videos/{{video_key}}/{FILE}.mp4"
README = "README.md"
INDICES = ("timestamp", "frame_index", "episode_index", "index", "task_index")
"""Columns that every row has; the first is float32, the others are int64."""
CODEC, PIXELS = "h264", "yuv420p"
"""Codec and pixel format of the films."""
QUANTILES = {"q01": 0.01, "q10": 0.1, "q50": 0.5, "q90": 0.9, "q99": 0.99}
IMAGE = "observation.images."


@dataclass(kw_only=True)
class Dataset:
    """A LeRobotDataset: parquet files of rows with images in them, and JSON beside. Format v3.0 is what lerobot reads
    since its release 0.4, v2.1 what openpi's trainer reads.

    It is written one episode at a time, each into a data file and films of its own; ``close`` writes the metadata.
    Images are PNG inside the rows, without loss. The names of the files and of the columns of v3.0 are those of
    huggingface/lerobot 7427f318, src/lerobot/datasets/utils.py, dataset_writer.py and compute_stats.py.
    """

    folder: Path
    robot: str
    version: Format = "v3.0"
    about: str = ""
    """Text for README.md, if any."""
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
        """Write one episode. Raises ConfigError, naming the trial, if it differs in streams, images or rate from those
        before."""
        if episode.clips and self.version != "v3.0":
            raise ConfigError("--video: only the format v3.0 holds films here; leave out --video or --form")
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
        frames = np.arange(length, dtype=np.int64)
        columns = {key: s.values for key, s in episode.streams.items()} | {
            "timestamp": (frames / episode.fps).astype(np.float32),
            "frame_index": frames,
            "episode_index": np.full(length, number, np.int64),
            "index": frames + self._rows,
            "task_index": np.full(length, self._tasks.index(episode.instruction), np.int64),
        }
        shown, pixels = dict[str, list[dict[str, Any]]](), dict[str, Any]()
        for camera, images in episode.images.items():
            encoded = [{"bytes": png(image), "path": None} for image in images]
            shown[IMAGE + camera] = [encoded[k] for k in episode.shown[camera]]
            pixels[IMAGE + camera] = histogram_of(images, episode.shown[camera])
        row: dict[str, Any] = {"episode_index": number, "tasks": [episode.instruction], "length": length}
        for camera, clip in episode.clips.items():
            key = IMAGE + camera
            film = self.folder / VIDEO_PATH.format(video_key=key, **place)
            film.parent.mkdir(parents=True, exist_ok=True)
            clip.path.rename(film)
            pixels[key] = clip.histogram
            row |= {f"videos/{key}/chunk_index": chunk, f"videos/{key}/file_index": file}
            row |= {f"videos/{key}/from_timestamp": 0.0, f"videos/{key}/to_timestamp": length / episode.fps}
        features = {**self._features, **_INDEX_FEATURES}
        _write(self.folder / DATA_PATHS[self.version].format(**place), columns, shown, features)
        for key, values in columns.items():
            self._columns.setdefault(key, []).append(values)
        for key, histogram in pixels.items():
            self._pixels[key] = self._pixels.get(key, 0) + histogram
        self._episodes.append(row)
        self._episode_stats.append(_stats(columns, pixels))
        self._rows += length

    def close(self) -> None:
        """Write the metadata. Raises ConfigError for a dataset without an episode."""
        if not self._episodes:
            raise ConfigError(f"{self.folder}: no trial could be exported, so there is no dataset")
        meta = self.folder / "meta"
        meta.mkdir(parents=True, exist_ok=True)
        if self.about:
            (self.folder / README).write_text(self.about)
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
        """Return v3.0's row of each episode; lerobot's tools read the columns ``stats/FEATURE/NAME``."""
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
            "video_path": VIDEO_PATH if any(f["dtype"] == "video" for f in self._features.values()) else None,
            "features": {**self._features, **_INDEX_FEATURES},
        }


_INDEX_FEATURES = {
    name: {"dtype": "float32" if name == "timestamp" else "int64", "shape": [1], "names": None} for name in INDICES
}


def features_of(episode: Episode) -> dict[str, Any]:
    """Name of each stream and camera -> its type, shape and names, as info.json has them."""
    features: dict[str, Any] = {
        key: {"dtype": str(stream.values.dtype), "shape": list(stream.values.shape[1:]), "names": list(stream.names)}
        for key, stream in episode.streams.items()
    }
    for camera, clip in episode.clips.items():
        height, width, channels = clip.shape
        film = {"height": height, "width": width, "codec": CODEC, "pix_fmt": PIXELS}
        info = {f"video.{name}": v for name, v in {**film, "fps": episode.fps, "channels": channels}.items()}
        features[IMAGE + camera] = {
            "dtype": "video",
            "shape": list(clip.shape),
            "names": ["height", "width", "channels"],
            "info": {**info, "is_depth_map": False, "has_audio": False},
        }
    for camera, images in episode.images.items():
        shape = list(images[0].shape)
        features[IMAGE + camera] = {"dtype": "image", "shape": shape, "names": ["height", "width", "channels"]}
    return features


def _write(
    path: Path, columns: dict[str, Any], images: dict[str, list[dict[str, Any]]], features: dict[str, Any]
) -> None:
    arrow, parquet = _pyarrow()
    arrays: dict[str, Any] = {}
    for name, values in columns.items():
        flat = values.ndim == 1 or values.shape[1:] == (1,)
        arrays[name] = arrow.array(
            values.reshape(-1) if flat else list(values) if values.ndim == 2 else values.tolist()
        )
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
    if len(feature["shape"]) == 2:
        return {"shape": feature["shape"], "dtype": feature["dtype"], "_type": "Array2D"}
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
    """Statistics of columns of rows, in lerobot's shapes: a list of numbers, (3, 1, 1) for images in [0, 1]."""
    stats: dict[str, Any] = {}
    rows = len(columns["index"])
    for key, values in columns.items():
        numbers = np.asarray(values, float).reshape(rows, -1)
        found = {"min": numbers.min(0), "max": numbers.max(0), "mean": numbers.mean(0), "std": numbers.std(0)}
        found |= {name: np.quantile(numbers, q, axis=0) for name, q in QUANTILES.items()}
        shape = values.shape[1:] or (1,)
        stats[key] = {**{name: row.reshape(shape).tolist() for name, row in found.items()}, "count": [rows]}
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


def _pyarrow() -> tuple[Any, Any]:
    try:
        return import_module("pyarrow"), import_module("pyarrow.parquet")
    except ModuleNotFoundError:
        raise DependencyError("a dataset needs pyarrow: pip install 'carecontact[tables]'") from None

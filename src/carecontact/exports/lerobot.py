"""A LeRobotDataset, format v3.0, as lerobot 0.4 reads it: parquet files of rows with images in them, and JSON beside.

Every episode is a data file of its own. Images are PNG inside the rows, without loss.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from carecontact.errors import ConfigError, DependencyError
from carecontact.exports.episode import Episode

FORMAT = "v3.0"
FILES_IN_CHUNK = 1000
FILE = "chunk-{chunk_index:03d}/file-{file_index:03d}"
INDICES = ("timestamp", "frame_index", "episode_index", "index", "task_index")
"""Columns that every row has; the first is float32, the others are int64."""
QUANTILES = {"q01": 0.01, "q10": 0.1, "q50": 0.5, "q90": 0.9, "q99": 0.99}


@dataclass(kw_only=True)
class Dataset:
    """A dataset that is written one episode at a time; ``close`` writes the metadata."""

    folder: Path
    robot: str
    _features: dict[str, Any] = field(default_factory=dict[str, Any])
    _hz: float = 0.0
    _tasks: list[str] = field(default_factory=list[str])
    _episodes: list[dict[str, Any]] = field(default_factory=list[dict[str, Any]])
    _columns: dict[str, list[Any]] = field(default_factory=dict[str, list[Any]])
    _pixels: dict[str, list[Any]] = field(default_factory=dict[str, list[Any]])
    _rows: int = 0

    def add(self, episode: Episode, *, name: str) -> None:
        """Write one episode. ``name``: of the trial, for messages.

        Raises ConfigError if its streams, images or rate are not those of the episodes before.
        """
        found = features_of(episode)
        if not self._features:
            self._features, self._hz = found, episode.hz
        if found != self._features or episode.hz != self._hz:
            differing = sorted(
                key for key in found.keys() | self._features.keys() if found.get(key) != self._features.get(key)
            )
            told = ", ".join(differing) or f"a rate of {episode.hz:g} Hz and not {self._hz:g} Hz"
            raise ConfigError(f"{name} cannot be in one dataset with the trials before it: it differs in {told}")
        if episode.instruction not in self._tasks:
            self._tasks.append(episode.instruction)
        number, length = len(self._episodes), len(episode)
        chunk, file = divmod(number, FILES_IN_CHUNK)
        path = self.folder / "data" / f"{FILE.format(chunk_index=chunk, file_index=file)}.parquet"
        rows = self._indices(episode, number)
        _write(path, {**{key: s.values for key, s in episode.streams.items()}, **rows}, _encoded(episode))
        for key, values in (*((key, s.values) for key, s in episode.streams.items()), *rows.items()):
            self._columns.setdefault(key, []).append(values)
        for camera, images in episode.images.items():
            self._pixels.setdefault(camera, []).extend(image[::8, ::8].reshape(-1, 3) for image in images)
        self._episodes.append(
            {
                "episode_index": number, "tasks": [episode.instruction], "length": length,
                "data/chunk_index": chunk, "data/file_index": file,
                "dataset_from_index": self._rows, "dataset_to_index": self._rows + length,
                "meta/episodes/chunk_index": 0, "meta/episodes/file_index": 0,
            }
        )  # fmt: skip
        self._rows += length

    def close(self) -> None:
        """Write the metadata. Raises ConfigError for a dataset without an episode."""
        if not self._episodes:
            raise ConfigError(f"{self.folder}: no trial could be exported, so there is no dataset")
        arrow, parquet = _pyarrow()
        meta = self.folder / "meta"
        (meta / "episodes" / "chunk-000").mkdir(parents=True, exist_ok=True)
        (meta / "info.json").write_text(json.dumps(self._info(), indent=4) + "\n")
        (meta / "stats.json").write_text(json.dumps(self._stats(), indent=4) + "\n")
        parquet.write_table(
            arrow.Table.from_pylist(self._episodes),
            meta / "episodes" / f"{FILE.format(chunk_index=0, file_index=0)}.parquet",
        )
        parquet.write_table(_task_table(self._tasks), meta / "tasks.parquet")

    def _indices(self, episode: Episode, number: int) -> dict[str, Any]:
        frames = np.arange(len(episode), dtype=np.int64)
        task = self._tasks.index(episode.instruction)
        return {
            "timestamp": (frames / episode.hz).astype(np.float32),
            "frame_index": frames,
            "episode_index": np.full(len(episode), number, np.int64),
            "index": frames + self._rows,
            "task_index": np.full(len(episode), task, np.int64),
        }

    def _info(self) -> dict[str, Any]:
        indices = {
            name: {"dtype": "float32" if name == "timestamp" else "int64", "shape": [1], "names": None}
            for name in INDICES
        }
        return {
            "codebase_version": FORMAT,
            "robot_type": self.robot,
            "total_episodes": len(self._episodes),
            "total_frames": self._rows,
            "total_tasks": len(self._tasks),
            "chunks_size": FILES_IN_CHUNK,
            "data_files_size_in_mb": 100,
            "video_files_size_in_mb": 200,
            "fps": int(self._hz) if self._hz == int(self._hz) else self._hz,
            "splits": {"train": f"0:{len(self._episodes)}"},
            "data_path": f"data/{FILE}.parquet",
            "video_path": None,
            "features": {**self._features, **indices},
        }

    def _stats(self) -> dict[str, Any]:
        """Return statistics of every column over all rows; of images over every eighth pixel each way of every image,
        in [0, 1]."""
        stats = {key: _statistics(np.concatenate(parts)) for key, parts in self._columns.items()}
        for camera, parts in self._pixels.items():
            found = _statistics(np.concatenate(parts) / 255.0)
            count = found.pop("count")
            images = {name: [[[v]] for v in values] for name, values in found.items()}
            stats[f"observation.images.{camera}"] = {**images, "count": count}
        return stats


def features_of(episode: Episode) -> dict[str, Any]:
    """Name of each stream and camera -> its type, shape and names, as info.json has them."""
    features: dict[str, Any] = {
        key: {"dtype": "float32", "shape": [len(stream.names)], "names": list(stream.names)}
        for key, stream in episode.streams.items()
    }
    for camera, images in episode.images.items():
        shape = list(images[0].shape)
        features[f"observation.images.{camera}"] = {
            "dtype": "image", "shape": shape, "names": ["height", "width", "channels"]
        }  # fmt: skip
    return features


def _encoded(episode: Episode) -> dict[str, list[dict[str, Any]]]:
    """Camera's column -> the image of every row as PNG."""
    columns: dict[str, list[dict[str, Any]]] = {}
    for camera, images in episode.images.items():
        png = [{"bytes": cv2.imencode(".png", image[:, :, ::-1])[1].tobytes(), "path": None} for image in images]
        columns[f"observation.images.{camera}"] = [png[k] for k in episode.shown]
    return columns


def _write(path: Path, columns: dict[str, Any], images: dict[str, list[dict[str, Any]]]) -> None:
    arrow, parquet = _pyarrow()
    arrays: dict[str, Any] = {}
    for name, values in columns.items():
        flat = values.ndim == 1 or values.shape[1] == 1
        arrays[name] = arrow.array(values.reshape(-1) if flat else list(values))
    kind = arrow.struct([("bytes", arrow.binary()), ("path", arrow.string())])
    arrays |= {name: arrow.array(rows, type=kind) for name, rows in images.items()}
    path.parent.mkdir(parents=True, exist_ok=True)
    # Rows that show the same image share its bytes in a file whose dictionary has room for all of them.
    parquet.write_table(arrow.table(arrays), path, dictionary_pagesize_limit=1 << 30)


def _task_table(tasks: Iterable[str]) -> Any:
    """Texts of the tasks as the index of a pandas frame, which is what the reader expects."""
    arrow, _ = _pyarrow()
    names = list(tasks)
    index = "__index_level_0__"
    text = {"name": None, "field_name": index, "pandas_type": "unicode", "numpy_type": "object", "metadata": None}
    number = {
        "name": "task_index",
        "field_name": "task_index",
        "pandas_type": "int64",
        "numpy_type": "int64",
        "metadata": None,
    }
    about = {"index_columns": [index], "column_indexes": [], "columns": [number, text], "pandas_version": "2.2.0"}
    table = arrow.table({"task_index": arrow.array(range(len(names)), type=arrow.int64()), index: names})
    return table.replace_schema_metadata({"pandas": json.dumps(about)})


def _statistics(values: Any) -> dict[str, Any]:
    """(N, D) or (N,) -> lists of D numbers."""
    columns = np.asarray(values, float).reshape(len(values), -1)
    found = {"min": columns.min(0), "max": columns.max(0), "mean": columns.mean(0), "std": columns.std(0)}
    found |= {name: np.quantile(columns, q, axis=0) for name, q in QUANTILES.items()}
    return {**{name: row.tolist() for name, row in found.items()}, "count": [len(columns)]}


def _pyarrow() -> tuple[Any, Any]:
    try:
        return import_module("pyarrow"), import_module("pyarrow.parquet")
    except ModuleNotFoundError:
        raise DependencyError("a dataset needs pyarrow: pip install 'carecontact[tables]'") from None

"""``carecontact export``: a dataset of what a policy saw and did."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar, Literal

import tyro

from carecontact.cli.groups import Switch
from carecontact.errors import ConfigError, RecordingError


@dataclass(frozen=True, kw_only=True)
class Export:
    """Write what the policy of a run saw and did as a dataset for training, one episode for each trial. Nothing that
    only the scorer sees is in it, unless you ask for it."""

    form: Annotated[Literal["lerobot", "lerobot-v2.1"], tyro.conf.Positional]
    """Format of the dataset: lerobot is LeRobotDataset v3.0, lerobot-v2.1 the earlier format that openpi reads."""
    run: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="RUN")]
    """Folder of a run with its recordings."""
    out: Path
    """Folder for the dataset; it must not exist yet."""
    only: Literal["all", "success", "region-correct", "safety-gated"] = "all"
    """Trials to export, by the scores in results.json."""
    with_force: Switch = False
    """Add the force on each body segment, which no policy receives. A policy that is trained on it cannot run in this
    benchmark."""

    after_interrupt: ClassVar[str] = "; the dataset is incomplete: remove its folder"

    def __call__(self) -> int:
        """Return 1 if a trial could not be exported."""
        from carecontact.exports.episode import episode_of
        from carecontact.exports.lerobot import Dataset
        from carecontact.recording import read_recording

        if self.out.exists():
            raise ConfigError(f"--out {self.out}: exists already; name a new folder")
        left_out = 0
        dataset = None
        for trial_id in self._trials():
            try:
                recording = read_recording(self.run / f"{trial_id}.h5")
                episode = episode_of(recording, force=self.with_force)
            except RecordingError as error:
                left_out += 1
                print(f"left out: {error}")
                continue
            version = "v2.1" if self.form == "lerobot-v2.1" else "v3.0"
            dataset = dataset or Dataset(folder=self.out, robot=recording.header.embodiment, version=version)
            dataset.add(episode, name=trial_id)
            print(f"{trial_id}: {len(episode)} rows at {episode.fps} fps", flush=True)
        if dataset is None:
            raise ConfigError(f"{self.run}: no trial could be exported, so there is no dataset")
        dataset.close()
        print(f"dataset: {self.out}")
        return 1 if left_out else 0

    def _trials(self) -> list[str]:
        """Return the recordings to export. Raises ConfigError if there are none."""
        from carecontact.cli.rescoring import need_recordings
        from carecontact.runs.stored_scores import read_scores

        need_recordings(self.run)
        if self.only == "all":
            return sorted(path.stem for path in self.run.glob("*.h5"))
        field = {"success": "c3_success", "region-correct": "region_correct", "safety-gated": "safety_gated"}[self.only]
        found = sorted(score.trial_id for score in read_scores(self.run).scores if getattr(score, field))
        if not found:
            raise ConfigError(f"{self.run}: no trial is {self.only}; without --only, all trials are exported")
        return found

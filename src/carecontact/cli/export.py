"""``carecontact export``: a dataset of what a policy saw and did, and the paper's tables and figures."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

import tyro

from carecontact.cli.groups import Switch, check_folder, need_recordings, read_run
from carecontact.cli.parsing import given_options
from carecontact.errors import ConfigError, RecordingError
from carecontact.interface.policy import CAMERAS

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from carecontact.protocol.protocol import Protocol
    from carecontact.recording.lerobot import Episode
    from carecontact.recording.schema import Header
    from carecontact.replay.dataset import Rendering
    from carecontact.runs.pooling import RunScores


@dataclass(frozen=True, kw_only=True)
class Lerobot:
    """Write what the policy of a run saw and did as a LeRobotDataset for training, one episode for each trial. Nothing
    that only the scorer sees is in it, unless you ask for it."""

    run: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="RUN")]
    """Folder of a run with its recordings."""
    out: Path
    """Folder for the dataset; it must not exist yet."""
    form: Literal["v3.0", "v2.1"] = "v3.0"
    """Version of the format; openpi reads v2.1."""
    only: Literal["all", "success", "region-correct", "safety-gated"] | None = None
    """Trials to export, by the scores in results.json; default: of demonstrations the safety-gated ones (of those with
    labels, all), of any other run all."""
    render: str = ""
    """Make the rows and their pictures again, by stepping the recordings again: cameras with the side of their square
    pictures [px], such as overhead:128,wrist:128. Without it, rows are the actions, with the pictures that were
    sent."""
    hz: float = 10.0
    """With --render: rows in a second."""
    video: Literal["h264"] | None = None
    """With --render: films in place of PNG, which take 2 % of the space and lose little."""
    points: int = 0
    """With --render: add as many coloured points inside the workspace, from the first camera's depth."""
    jobs: int | None = None
    """With --render: trials at once; default: one per core."""
    with_force: Switch = False
    """Add the force on each body segment, which no policy receives. A policy that is trained on it cannot run in this
    benchmark."""

    after_interrupt: ClassVar[str] = "; the dataset is incomplete: remove its folder"

    def __call__(self) -> int:
        from carecontact.recording import read_header
        from carecontact.recording.lerobot import about_dataset
        from carecontact.recording.lerobot_file import Dataset

        if self.out.exists():
            raise ConfigError(f"--out {self.out}: exists already; name a new folder")
        need_recordings(self.run)
        first = read_header(min(self.run.glob("*.h5")))
        chosen, left_out, written = self._trials(first), 0, 0
        trials = self.only or "all, of demonstrations without labels the safety-gated ones"
        rendered = f" Rows: {self.hz:g} a second, with {self.render}." if self.render else ""
        about = about_dataset(first, rendered=bool(self.render), trials=f"{trials}.{rendered}")
        dataset = Dataset(folder=self.out, robot=first.embodiment, version=self.form, about=about)
        for trial_id, found in self._episodes(chosen):
            if isinstance(found, str):
                left_out += 1
                print(f"left out: {found}")
                continue
            dataset.add(found, name=trial_id)
            written += 1
            print(f"{trial_id}: {len(found)} rows at {found.fps} fps", flush=True)
        if not written:
            raise ConfigError(f"{self.run}: no trial could be exported, so there is no dataset")
        dataset.close()
        print(f"dataset: {self.out}")
        return 1 if left_out else 0

    def _episodes(self, trials: Sequence[str]) -> Iterator[tuple[str, Episode | str]]:
        """Yield each trial with its episode, or with the reason why it has none, in their order."""
        from carecontact.recording import read_recording
        from carecontact.recording.lerobot import episode_of

        rendering = self._rendering()
        if rendering is not None:
            from carecontact.replay.dataset import rendered

            scores = {score.trial_id: score for score in read_run(self.run).scores}
            passed = [trial for trial in trials if trial in scores and scores[trial].safety_gated]
            yield from rendered(self.run, trials, rendering, passed=passed, jobs=self.jobs)
            return
        for trial_id in trials:
            try:
                yield trial_id, episode_of(read_recording(self.run / f"{trial_id}.h5"), force=self.with_force)
            except RecordingError as error:
                yield trial_id, str(error)

    def _rendering(self) -> Rendering | None:
        from carecontact.replay.dataset import Rendering
        from carecontact.running.supervisor import check_jobs

        check_jobs(self.jobs)
        if not self.render:
            needless = [o for o in given_options(self) if o in ("--hz", "--video", "--points", "--jobs")]
            if needless:
                raise ConfigError(f"{needless[0]} belongs to --render, such as --render overhead:128,wrist:128")
            return None
        if self.with_force:
            raise ConfigError("--with-force does not go with --render, whose rows hold only what a policy may know")
        sizes: dict[str, int] = {}
        for part in self.render.split(","):
            camera, _, side = part.partition(":")
            if camera not in CAMERAS or not side.isdecimal() or not 16 <= int(side) <= 480 or int(side) % 2:
                raise ConfigError(
                    f"--render {part}: expected CAMERA:PX with a camera of {', '.join(CAMERAS)} and an even number of "
                    "pixels from 16 to 480, such as overhead:128"
                )
            sizes[camera] = int(side)
        if not 1 <= self.hz <= 50:
            raise ConfigError(f"--hz {self.hz:g}: expected 1 to 50")
        if not 0 <= self.points <= 65536:
            raise ConfigError(f"--points {self.points}: expected 0 to 65536")
        return Rendering(sizes=sizes, hz=self.hz, film=self.video is not None, points=self.points)

    def _trials(self, first: Header) -> list[str]:
        from carecontact.runs.scoring import read_scores

        only = self.only
        if only is None:
            only = "safety-gated" if first.spec.trains and not first.spec.policy.endswith("+dagger") else "all"
        if only == "all":
            return sorted(path.stem for path in self.run.glob("*.h5"))
        field = {"success": "c3_success", "region-correct": "region_correct", "safety-gated": "safety_gated"}[only]
        found = sorted(score.trial_id for score in read_scores(self.run).scores if getattr(score, field))
        if not found:
            raise ConfigError(f"{self.run}: no trial is {only}; with --only all, all trials are exported")
        return found


@dataclass(frozen=True, kw_only=True)
class Paper:
    """Write the tables of the paper (as LaTeX, CSV and Markdown) and its figures (as SVG and PDF) from your runs, with
    the values that the paper prints beside yours. The same runs give the same bytes."""

    runs: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="RUN [RUN ...]")]
    """Folders of runs of one protocol, one policy each, or their results.json (also .json.gz) alone."""
    out: Path = Path("paper")
    """Folder for tables and figures."""
    no_figures: Switch = False
    """Write the tables only, and remove figures that an earlier command wrote into the folder."""

    after_interrupt: ClassVar[str] = "; what was written stays"

    def __call__(self) -> int:
        from carecontact.report.comparison import check_complete, check_different
        from carecontact.report.paper import remove_earlier, tables_of, write_tables
        from carecontact.runs.pooling import rejected_text

        if not self.runs:
            raise ConfigError("expected one or more runs; name their folders")
        check_folder(self.out)
        check_different(self.runs)
        runs = [read_run(path) for path in self.runs]
        check_complete({str(path): run for path, run in zip(self.runs, runs, strict=True)})
        for line in {text for run in runs if (text := rejected_text(run.scores))}:
            print(f"warning: {line}")
        protocol = _protocol(self.runs, runs)
        if protocol is None:
            print("the tables of tasks and protocol are left out: no recording and no shipped protocol has the rules")
        written = write_tables(tables_of(runs, protocol), self.out / "tables")
        if not self.no_figures:
            written += self._figures(runs)
        for path in written:
            print(path)
        for path in remove_earlier(self.out, written):
            print(f"removed {path}, which an earlier command had written")
        return 0

    def _figures(self, runs: Sequence[RunScores]) -> list[Path]:
        from carecontact.recording import read_recording
        from carecontact.report.paper import write_figures

        folders = {number: path for number, path in enumerate(self.runs) if any(path.glob("*.h5"))}
        if not folders:
            print("no run has recordings: the figures of traces and of force and indentation are left out")
        read = {
            number: (lambda trial_id, folder=folder: read_recording(folder / f"{trial_id}.h5"))
            for number, folder in folders.items()
        }
        return write_figures(runs, read, self.out / "figures")


def _protocol(places: Sequence[Path], runs: Sequence[RunScores]) -> Protocol | None:
    """Return the protocol of the runs, from a recording or, if the hash is the same, from this release."""
    from carecontact.protocol.load import load_protocol, shipped_protocols
    from carecontact.recording import read_header

    recording = next((file for place in places for file in sorted(place.glob("*.h5"))), None)
    if recording is not None:
        return read_header(recording).spec.protocol
    first = next((score for run in runs for score in run.scores), None)
    if first is None or first.overrides:
        return None
    name, _, level = first.protocol_id.partition(" ")
    if name not in shipped_protocols():
        return None
    found = load_protocol(name, level=level or None)
    return found if found.sha256 == first.protocol_sha256 else None

from __future__ import annotations

import errno
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
import psutil
import pytest

from carecontact.episode.randomization import World
from carecontact.errors import ConfigError, counted
from carecontact.protocol.load import load_protocol
from carecontact.protocol.protocol import TrialSpec
from carecontact.recording import canonical_hash, read_recording, write_recording
from carecontact.running.pace import ACT, BETWEEN, PACED, WARM_S, Pace, check_pace
from carecontact.running.trial import run_trial
from carecontact.runs import score_run, scoring
from carecontact.runs.scorer import FEW, Scorer
from carecontact.serving.conversation import PolicySetup
from tests.scoring.synthetic import make_recording, push, touch


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_recording(touch(seed=0), tmp_path / "T1-s000.h5")
    write_recording(make_recording("T1", seed=1), tmp_path / "T1-s001.h5")
    write_recording(push(seed=0), tmp_path / "T2-s000.h5")
    (tmp_path / "T4-s000.h5").write_text("not a recording")
    return tmp_path


@pytest.fixture(scope="module", params=[1, FEW], ids=["thread", "processes"])
def scorer(request: pytest.FixtureRequest) -> Iterator[Scorer]:
    with closing(Scorer(1, trials=request.param)) as scorer:
        yield scorer


def test_what_was_scored_is_not_scored_again(folder: Path, scorer: Scorer, monkeypatch: pytest.MonkeyPatch) -> None:
    alone, again = score_run(folder), list[Path]()
    scorer.fill(sorted(folder.glob("*.h5")))
    score_files = scoring.score_files
    monkeypatch.setattr(scoring, "score_files", lambda paths, **more: again.extend(paths) or score_files(paths, **more))
    assert score_run(folder, scored=scorer.take) == alone
    assert [path.name for path in again] == ["T4-s000.h5"], "it says why it cannot be scored"


def test_the_score_of_another_recording_does_not_count(folder: Path, scorer: Scorer) -> None:
    changed, whole = folder / "T1-s000.h5", folder / "T2-s000.h5"
    for path in (changed, whole):
        scorer.give(path)
    before = scorer.take(whole)
    scorer.give(whole)
    write_recording(touch(force=9.0, seed=0), changed)
    assert scorer.take(changed) is None
    assert scorer.take(changed.with_name("T9-s000.h5")) is None, "it was never given"
    assert before is not None
    assert scorer.take(whole) == before


def test_each_score_is_handed_on(folder: Path, scorer: Scorer) -> None:
    scored: list[str] = []
    paths = sorted(folder.glob("*.h5"))
    for path in paths:
        scorer.give(path, then=lambda score: scored.append(score.trial_id))
    scorer.wait()
    assert sorted(scored) == ["T1-s000", "T1-s001", "T2-s000"]
    assert [scorer.score_of(path) is None for path in paths] == [False, False, False, True]


def test_no_policy_can_reach_what_the_scoring_processes_share(folder: Path) -> None:
    def shared() -> set[str]:
        return {line.split()[-1] for line in Path("/proc/self/maps").read_text().splitlines() if "/dev/shm/" in line}

    before = shared()
    with closing(Scorer(1, trials=FEW)) as scorer:
        assert scorer.score_of(folder / "T1-s000.h5") is not None
        assert shared() == before


def test_a_scoring_process_that_dies_costs_one_score(folder: Path) -> None:
    before = set(psutil.Process().children())
    with closing(Scorer(1, trials=FEW)) as scorer:
        assert scorer.score_of(folder / "T1-s000.h5") is not None
        (process,) = set(psutil.Process().children()) - before
        process.kill()
        assert scorer.score_of(folder / "T1-s001.h5") is None
        assert scorer.score_of(folder / "T2-s000.h5") is not None
        (process,) = set(psutil.Process().children()) - before
    assert not process.is_running()


@pytest.mark.parametrize("trials", [1, FEW], ids=["thread", "processes"])
def test_where_nothing_can_be_started_it_is_scored_later(
    folder: Path, monkeypatch: pytest.MonkeyPatch, trials: int
) -> None:
    def refused(*given: object, **more: object) -> None:
        raise RuntimeError("can't start new thread") if trials == 1 else BlockingIOError(errno.EAGAIN, "no process")

    path = folder / "T1-s000.h5"
    with closing(Scorer(1, trials=trials)) as scorer:
        with monkeypatch.context() as patch:
            if trials == 1:
                patch.setattr(threading.Thread, "start", refused)
            else:
                patch.setattr(subprocess.Popen, "_execute_child", refused)
            scorer.give(path)
            assert scorer.take(path) is None
        assert scorer.score_of(path) is not None


class Clock:
    now = 100.0
    slept = 0.0

    def __call__(self) -> float:
        self.now += 1e-5
        return self.now

    def sleep(self, seconds: float) -> None:
        # As a system does: at times a little too short.
        self.now += max(seconds - 0.001, 1e-4)
        self.slept = self.now


@pytest.mark.parametrize(
    ("periods", "took_s", "leaves_s", "late"),
    [(1, 0.0, 0.5, 0), (1, 0.399, 0.5, 0), (3, 0.7, 1.5, 0), (1, 0.41, 1.0, 1), (1, 1.3, 1.5, 1), (2, 1.3, 1.5, 1)],
)
def test_an_observation_leaves_on_the_grid(periods: int, took_s: float, leaves_s: float, late: int) -> None:
    clock = Clock()
    pace = Pace(0.5, clock=clock, sleep=clock.sleep)
    pace.hold()
    assert clock.now == pytest.approx(100.0, abs=1e-3), "the first one answers nothing"
    pace.answered(periods)
    clock.now += took_s
    made: list[float] = []
    pace.hold(lambda: made.append(clock.now))
    assert clock.now == pytest.approx(100.0 + leaves_s, abs=1e-3)
    assert made == pytest.approx([100.0 + leaves_s - WARM_S], abs=1e-3)
    assert clock.slept < 100.0 + leaves_s - WARM_S + 1e-3, "it does not sleep after that"
    found = pace.arrays()
    assert found[BETWEEN] == pytest.approx([leaves_s], abs=1e-3)
    assert found[PACED].tolist() == [0.5, late]


def test_without_a_pace_nothing_waits_and_the_time_is_noted() -> None:
    clock = Clock()
    pace = Pace(None, clock=clock, sleep=clock.sleep)
    pace.hold()
    clock.now += 0.7
    pace.answered(1)
    clock.now += 0.3
    pace.hold()
    clock.now += 0.2
    pace.answered(1)
    assert {name: values.tolist() for name, values in pace.arrays().items()} == {
        BETWEEN: [pytest.approx(0.3, abs=1e-3)],
        ACT: [pytest.approx(t, abs=1e-3) for t in (0.7, 0.2)],
    }


@pytest.mark.parametrize("wrong", [0.1, -1.0, 5.1, float("nan")])
def test_a_pace_that_no_trial_can_keep_is_refused(wrong: float) -> None:
    with pytest.raises(ConfigError, match=r"--pace .*: must be above 0.1 s, because .* and at most 5 s"):
        check_pace(wrong)


POLICY = """
from carecontact.interface.action import Action
from carecontact.interface.policy import PolicyCard

class Still:
    card = PolicyCard(name="still")
    acts = 0
    def reset(self, instruction): pass
    def act(self, observation):
        self.acts += 1
        return [Action()] * (self.acts % 2) + [Action(done=self.acts == 4)]
"""


def test_a_trial_keeps_its_pace_and_the_hash_stays(tmp_path: Path, again: Callable[..., World]) -> None:
    (tmp_path / "still.py").write_text(POLICY)
    setup = PolicySetup.of("still:Still", search_path=[str(tmp_path)])
    spec = TrialSpec(protocol=load_protocol("bathing-v3"), task_id="T1", seed=0, policy="still:Still")
    free, paced = (run_trial(spec, policy=setup, pace_s=pace_s, prepare=again) for pace_s in (None, 0.5))
    assert canonical_hash(free) == canonical_hash(paced)
    periods = np.bincount(paced["actions/observation_index"])[: len(paced[BETWEEN])]
    assert (paced[BETWEEN] >= 0.5 * periods).all()


@pytest.mark.slow
def test_a_run_keeps_its_pace_and_says_what_was_late(tmp_path: Path) -> None:
    def run(name: str, *options: str) -> str:
        command = [
            sys.executable,
            "-m",
            "carecontact",
            "run",
            "--policy",
            "still:Still",
            "--tasks",
            "T1",
            "--seeds",
            "0",
        ]
        command += ["--seeds", "0", "--fast", "--out", str(tmp_path / name), *options]
        return subprocess.run(command, capture_output=True, text=True, check=True, cwd=tmp_path).stdout

    (tmp_path / "still.py").write_text(POLICY)
    run("free")
    assert "too late" not in run("paced", "--pace", "0.8")
    out = run("hasty", "--pace", "0.101")
    found = {name: read_recording(tmp_path / name / "T1-s000.h5") for name in ("free", "paced", "hasty")}
    assert len({recording.stored_sha256 for recording in found.values()}) == 1
    between = {name: recording[BETWEEN] for name, recording in found.items()}
    acts = len(found["free"]["policy/observation_time_s"])
    assert {len(times) for times in between.values()} == {acts - 1}
    assert acts == 4
    periods = np.bincount(found["free"]["actions/observation_index"])[: acts - 1]
    assert (between["paced"] >= 0.8 * periods).all()
    assert found["paced"][PACED].tolist() == [0.8, 0.0]
    late = int(found["hasty"][PACED][1])
    assert late > 0
    assert f"warning: --pace 0.101: {counted(late, 'observation')} of 1 trial came too late" in out
    assert (
        "0.8 s for each control period; observations came late in 0 of 1"
        in (tmp_path / "paced" / "report.html").read_text()
    )

from __future__ import annotations

import errno
import subprocess
import threading
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import psutil
import pytest

from carecontact.recording import write_recording
from carecontact.runs import score_folder, score_run
from carecontact.trials.scorer import FEW, Scorer
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
    score_files = score_folder.score_files
    monkeypatch.setattr(
        score_folder, "score_files", lambda paths, **more: again.extend(paths) or score_files(paths, **more)
    )
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
    assert scorer.take(changed.with_name("T9-s000.h5")) is None, "nobody gave it"
    assert before is not None
    assert scorer.take(whole) == before


def test_each_score_is_told(folder: Path, scorer: Scorer) -> None:
    told: list[str] = []
    paths = sorted(folder.glob("*.h5"))
    for path in paths:
        scorer.give(path, then=lambda score: told.append(score.trial_id))
    scorer.wait()
    assert sorted(told) == ["T1-s000", "T1-s001", "T2-s000"]
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

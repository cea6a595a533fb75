"""``import carecontact`` for programs: a run as tables, arrays and scores."""

from __future__ import annotations

import functools
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import carecontact as cc
from carecontact.api import evaluate as module
from carecontact.api import run
from carecontact.errors import ConfigError, DependencyError
from carecontact.recording import write_recording
from carecontact.running import machine, supervisor
from carecontact.runs import score_run, write_scores
from carecontact.serving.fence import version
from tests.api.still import Still
from tests.running.forked_fakes import FAKE, fork_fakes
from tests.scoring.synthetic import make_recording, push, touch


@pytest.fixture
def runs(tmp_path: Path) -> Path:
    """A touches and pushes; B does not touch with seed 1."""
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        for seed in (0, 1):
            missed = name == "b" and seed == 1
            made = make_recording("T1", seed=seed, policy=name) if missed else touch(seed=seed, policy=name)
            write_recording(made, tmp_path / name / f"T1-s{seed:03d}.h5")
        write_recording(push(seed=0, policy=name), tmp_path / name / "T2-s000.h5")
        write_scores(tmp_path / name, score_run(tmp_path / name))
    return tmp_path


def test_the_import_costs_nothing_until_something_is_used() -> None:
    code = (
        "import sys; before = set(sys.modules); import carecontact as cc; dir(cc)\n"
        "print(sorted(m for m in set(sys.modules) - before if m.partition('.')[0] != 'importlib'))\n"
        "assert cc.load and 'numpy' in sys.modules and 'pandas' not in sys.modules and 'mujoco' not in sys.modules"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert set(done.stdout.strip("[]\n").replace("'", "").split(", ")) <= {"carecontact", "warnings"}


def test_a_name_that_is_not_offered_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="it offers Run, compare, evaluate, load"):
        cc.lode  # type: ignore[attr-defined]  # noqa: B018
    assert {"Run", "compare", "evaluate", "load"} <= set(dir(cc))


def test_a_run_has_what_its_files_say(runs: Path) -> None:
    run = cc.load(runs / "a")
    assert repr(run) == f"Run({str(runs / 'a')!r}: a, 3 trials)"
    assert run.results == json.loads((runs / "a" / "results.json").read_text())
    assert [score.trial_id for score in run.scores] == ["T1-s000", "T1-s001", "T2-s000"] == list(run.recordings)
    force = run.recordings["T1-s000"]["scorer/normal_force"]
    assert isinstance(force, np.ndarray)
    assert force.max() > 0
    assert cc.load(runs / "a" / "results.json").recordings["T1-s000"].header.spec.task_id == "T1"
    assert cc.load(str(runs / "a"), rescore=True).scores == run.scores


def test_errors_say_what_is_there(runs: Path) -> None:
    with pytest.raises(ConfigError, match="no such folder; name the --out"):
        cc.load(runs / "nowhere")
    with pytest.raises(ConfigError, match=r"no recording of 'T1-s009' \(did you mean .*; it has T1-s000 to T2-s000"):
        cc.load(runs / "a").recordings["T1-s009"]
    with pytest.raises(ConfigError, match=r"no table for 'panda' .did you mean 'pandas'"):
        cc.load(runs / "a").trials("panda")  # type: ignore[arg-type]


def test_trials_are_a_table_of_any_library(runs: Path) -> None:
    run = cc.load(runs / "b")
    in_pandas, in_polars, in_arrow = run.trials("pandas"), run.trials("polars"), run.trials("pyarrow")
    assert type(run.trials()) is type(in_pandas)
    assert list(in_pandas.columns) == in_polars.columns == in_arrow.column_names
    assert in_pandas["trial_id"].tolist() == in_polars["trial_id"].to_list() == ["T1-s000", "T1-s001", "T2-s000"]
    assert in_pandas["c3_success"].dtype == "boolean"
    assert in_pandas["c1_peak_force_n"].isna().tolist() == [False, True, False]
    assert in_polars["c1_peak_force_n"].is_null().to_list() == [False, True, False]
    by_task = in_pandas.groupby("task_id")["c3_success"].mean()
    assert by_task.to_dict() == {"T1": 0.5, "T2": 1.0}


def test_the_extra_tables_brings_what_a_table_needs(runs: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    brought = machine.EXTRAS["tables"][0]
    monkeypatch.setattr(run, "find_spec", lambda name: name in brought or None)
    for name in set(run.LIBRARIES) - set(brought):
        monkeypatch.setitem(sys.modules, name, None)
    assert len(cc.load(runs / "a").trials()) == 3


def test_without_any_library_it_says_what_to_install(runs: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    loaded = cc.load(runs / "a")
    monkeypatch.setattr(run, "find_spec", lambda name: name == "polars")
    assert type(loaded.trials()).__module__.startswith("polars")
    monkeypatch.setattr(run, "find_spec", lambda name: None)
    with pytest.raises(DependencyError, match=r"neither pandas nor polars is installed: pip .*carecontact\[tables\]"):
        loaded.trials()
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(DependencyError, match=r"pandas is not installed: pip install 'carecontact\[tables\]'"):
        loaded.trials("pandas")
    monkeypatch.setitem(sys.modules, "polars", None)
    with pytest.raises(DependencyError, match="polars is not installed: pip install polars"):
        loaded.trials("polars")


def test_compare_is_that_of_the_command(runs: Path) -> None:
    found = cc.compare(cc.load(runs / "a"), runs / "b", per_task=True)
    assert found.pairing.n == 3
    assert [line.outcome.id for line in found.overall][:3] == ["success", "region_correct", "safety_gated"]
    assert found.per_task is not None
    assert found.as_json()["schema"] == "carecontact-comparison-2"


@pytest.mark.parametrize("b", ["a", "a/results.json"])
def test_a_run_is_not_compared_with_itself(runs: Path, b: str) -> None:
    for a in (runs / "a", cc.load(runs / "a")):
        with pytest.raises(ConfigError, match="is given twice; name different runs"):
            cc.compare(a, str(runs / b))


def test_messages_of_scores_name_no_option_of_a_command(runs: Path) -> None:
    (runs / "a" / "results.json").unlink()
    with pytest.raises(ConfigError, match=r"`carecontact report --rescore .*`, or load it with rescore=True$"):
        cc.load(runs / "a")


def test_a_recording_lists_its_arrays_and_names_them_when_one_is_not_there(runs: Path) -> None:
    recording = cc.load(runs / "a").recordings["T1-s000"]
    assert list(recording) == list(recording.arrays) == list(recording.keys())
    assert len(recording) == len(recording.arrays)
    assert "scorer/time_s" in recording
    assert "scorer/time" not in recording
    with pytest.raises(KeyError, match=r"no array named 'scorer/tim_s' \(did you mean 'scorer/time_s'\?\); valid: "):
        recording["scorer/tim_s"]
    with pytest.raises(ConfigError, match="no array named '0'; valid: "):
        recording[0]  # type: ignore[index]


def test_wrong_names_are_named_with_the_right_ones(runs: Path) -> None:
    run = cc.load(runs / "a")
    with pytest.raises(ConfigError, match="has no recording of 0; it has T1-s000 to T2-s000"):
        run.recordings[0]  # type: ignore[index]
    assert run.recordings.get("T9-s000") is None
    with pytest.raises(KeyError, match=r"no part of the results named 'overal' \(did you mean 'overall'\?\); valid: "):
        run.results["overal"]
    with pytest.raises(ConfigError, match="there is no table for 3; valid: pandas, polars, pyarrow"):
        run.trials(3)  # type: ignore[arg-type]


def test_a_place_that_is_no_run_is_named(runs: Path) -> None:
    with pytest.raises(ConfigError, match=r"load the run's folder, then .* run\.recordings\['T1-s000'\]"):
        cc.load(runs / "a" / "T1-s000.h5")
    with pytest.raises(ConfigError, match=r"^3 is no place of a run; name its folder"):
        cc.load(3)  # type: ignore[arg-type]
    (runs / "a" / "report.html").write_text("<html>")
    with pytest.raises(ConfigError, match="this is no run; name the folder of a run"):
        cc.load(runs / "a" / "report.html")


# A policy evaluated from Python: by name, as a class, and as an object that stays in this process.


@pytest.fixture
def fake(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> pytest.MonkeyPatch:
    """Workers that only write recordings."""
    monkeypatch.setattr(module, "run_trials", functools.partial(supervisor.run_trials, worker_command=FAKE))
    fork_fakes(monkeypatch)
    monkeypatch.setenv("FAKE_LOG", str(tmp_path / "ran.txt"))
    monkeypatch.setenv("FAKE_PLAN", "{}")
    monkeypatch.setenv("PYTHONPATH", str(Path(cc.__file__).parents[1]))
    monkeypatch.chdir(tmp_path)
    return monkeypatch


def test_a_name_is_run_scored_and_gone_on_with(fake: pytest.MonkeyPatch, tmp_path: Path) -> None:
    events: list[str] = []
    out = tmp_path / "runs" / "a"

    def call(seeds: Any) -> cc.Run:
        return cc.evaluate(
            "hover", out=out, tasks=["T1", "T2"], seeds=seeds, jobs=1, on_event=lambda e: events.append(e.kind)
        )

    assert [score.trial_id for score in call(0).scores] == ["T1-s000", "T2-s000"]
    run = call(range(2))
    assert len(run.scores) == 4
    assert events.count("kept") == 2
    assert (out / "results.parquet").is_file()
    assert cc.load(out).scores == run.scores


def test_a_class_runs_by_its_name_in_a_process_of_its_own(fake: pytest.MonkeyPatch, tmp_path: Path) -> None:
    run = cc.evaluate(Still, out=tmp_path / "a", tasks="T1", seeds=0, arguments={"steps": 2}, jobs=1)
    assert run.scores[0].policy == "tests.api.still:Still"
    assert run.scores[0].policy_arguments == {"steps": "2"}


PEEK = """
from carecontact.interface.policy import PolicyCard

class Peek:
    card = PolicyCard(name="peek")
    reset = act = print
    def __init__(self):
        try:
            open("runs/b/manifest.json").close()
        except PermissionError:
            return
        raise RuntimeError("it reads another run")
"""


@pytest.mark.skipif(not version(), reason="this system has no Landlock")
def test_no_run_is_open_to_a_policy_that_is_tried_before_its_trials(fake: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "peek.py").write_text(PEEK)
    (tmp_path / "runs" / "b").mkdir(parents=True)
    (tmp_path / "runs" / "b" / "manifest.json").touch()
    assert len(cc.evaluate("peek:Peek", out="runs/a", tasks="T1", seeds=0, jobs=1).scores) == 1


@pytest.mark.slow
def test_an_object_stays_in_this_process(tmp_path: Path) -> None:
    policy = Still()
    run = cc.evaluate(policy, out=tmp_path / "a", tasks="T1", seeds="0-1", port=0, overrides={"physics.dt_s": 0.004})
    assert policy.instructions == ["gently touch the right forearm"] * 2
    assert [score.ended for score in run.scores] == ["done", "done"]
    assert run.scores[0].overrides == {"physics.dt_s": "0.004"}


def test_what_cannot_be_evaluated_is_refused_before_anything_runs(tmp_path: Path) -> None:
    class Local(Still):
        pass

    out = tmp_path / "a"
    for options, message in (
        ({"policy": Local}, "policy .*Local: another process cannot import it"),
        ({"policy": object()}, "the object object has no card and no reset and no act"),
        ({"policy": Still(), "jobs": 2}, "jobs=2: a policy object answers one trial at a time"),
        ({"policy": Still(), "arguments": {"steps": 1}}, "arguments: a policy object is constructed already"),
        ({"policy": "hover", "tasks": ["T9"]}, "^tasks: 'T9' is not a task"),
        ({"policy": "hover", "overrides": {"physics.dt": 1}}, "physics.dt"),
        ({"policy": "tests.api.still:Nobody"}, "does not start: .*Nobody"),
    ):
        with pytest.raises(ConfigError, match=message):
            cc.evaluate(**{"out": out, "tasks": "T1", "seeds": 0, **options})
    assert not out.exists()


def test_a_port_that_is_taken_is_named(tmp_path: Path) -> None:
    from carecontact.serving.serve import served

    with served(Still(), port=0) as address:
        port = int(address.rpartition(":")[2])
        with pytest.raises(ConfigError, match=f"cannot listen on 127.0.0.1, port {port}: .*; give another port"):
            cc.evaluate(Still(), out=tmp_path / "a", tasks="T1", seeds=0, port=port)


def test_a_level_of_a_protocol_is_chosen_by_name(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"no level named 'L4'.*valid: L0, L1, L2, L3"):
        cc.evaluate("hover", out=tmp_path, level="L4")
    with pytest.raises(ConfigError, match=r"^seeds: "):
        cc.evaluate("hover", out=tmp_path, protocol="bathing-wide-v2", level="L2", seeds="100000")
    with pytest.raises(ConfigError, match="seeds=None: expected a text, a number or a list"):
        cc.evaluate("hover", out=tmp_path, seeds=None)  # type: ignore[arg-type]

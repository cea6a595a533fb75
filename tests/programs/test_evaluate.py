"""A policy evaluated from Python: by name, as a class, and as an object that stays in this process."""

from __future__ import annotations

import functools
import sys
from pathlib import Path
from typing import Any

import pytest

import carecontact as cc
from carecontact.errors import ConfigError
from carecontact.hosting.isolation.landlock import version
from carecontact.programs import evaluate as module
from carecontact.trials import supervisor
from tests.programs.still import Still

FAKE = (sys.executable, str(Path(__file__).parents[1] / "trials" / "fake_worker.py"))


@pytest.fixture
def fake(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> pytest.MonkeyPatch:
    """Workers that only write recordings."""
    monkeypatch.setattr(module, "run_trials", functools.partial(supervisor.run_trials, worker_command=FAKE))
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
    assert run.scores[0].policy == "tests.programs.still:Still"
    assert run.scores[0].policy_arguments == {"steps": "2"}


PEEK = """
from carecontact.contract.policy import PolicyCard

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
    for options, told in (
        ({"policy": Local}, "policy .*Local: another process cannot import it"),
        ({"policy": object()}, "the object object has no card and no reset and no act"),
        ({"policy": Still(), "jobs": 2}, "jobs=2: a policy object answers one trial at a time"),
        ({"policy": Still(), "arguments": {"steps": 1}}, "arguments: a policy object is constructed already"),
        ({"policy": "hover", "tasks": ["T9"]}, "^tasks: 'T9' is not a task"),
        ({"policy": "hover", "overrides": {"physics.dt": 1}}, "physics.dt"),
        ({"policy": "tests.programs.still:Nobody"}, "does not start: .*Nobody"),
    ):
        with pytest.raises(ConfigError, match=told):
            cc.evaluate(**{"out": out, "tasks": "T1", "seeds": 0, **options})
    assert not out.exists()


def test_a_port_that_is_taken_is_named(tmp_path: Path) -> None:
    from carecontact.hosting.in_process import served

    with served(Still(), port=0) as address:
        port = int(address.rpartition(":")[2])
        with pytest.raises(ConfigError, match=f"cannot listen on 127.0.0.1, port {port}: .*; give another port"):
            cc.evaluate(Still(), out=tmp_path / "a", tasks="T1", seeds=0, port=port)


def test_a_level_of_a_protocol_is_chosen_by_name(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"bathing-wide-v2-draft.*L0, L1, L2, L3"):
        cc.evaluate("hover", out=tmp_path, protocol="bathing-wide-v2-draft")
    with pytest.raises(ConfigError, match=r"^seeds: "):
        cc.evaluate("hover", out=tmp_path, protocol="bathing-wide-v2-draft", level="L2", seeds="100000")
    with pytest.raises(ConfigError, match="seeds=None: expected a text, a number or a list"):
        cc.evaluate("hover", out=tmp_path, seeds=None)  # type: ignore[arg-type]

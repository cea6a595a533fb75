from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pytest

import carecontact
from carecontact.cli import main
from carecontact.errors import ConfigError, RecordingError
from carecontact.recording import write_recording
from carecontact.runs import append_metrics, score_run, write_scores
from carecontact.scoring import METRICS, metric
from carecontact.scoring.contact import Contact
from tests.scoring.synthetic import before_start, make_recording, push, scrub, touch

NEW = "C1@2"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_recording(touch(seed=0), tmp_path / "T1-s000.h5")
    write_recording(make_recording("T1", seed=1), tmp_path / "T1-s001.h5")
    write_recording(push(), tmp_path / "T2-s000.h5")
    write_recording(scrub(), tmp_path / "T3-s000.h5")
    write_scores(tmp_path, score_run(tmp_path))
    return tmp_path


def mean_force(contact: Contact) -> float | None:
    return float(contact.force_in_window.mean()) if contact.valid else None


@pytest.fixture
def new_metric() -> Iterator[str]:
    """A second version of C1, as a later release or another package would register it."""
    metric(NEW, title="Mean force", unit="N", better="lower")(mean_force)
    yield NEW
    del METRICS._rows[NEW]


def without(data: Any, key: str) -> Any:
    if isinstance(data, dict):
        return {k: without(v, key) for k, v in data.items() if k != key}
    return [without(v, key) for v in data] if isinstance(data, list) else data


def test_append_adds_and_changes_nothing(folder: Path, new_metric: str) -> None:
    path = folder / "results.json"
    before = json.loads(path.read_text())
    found = append_metrics(folder)
    after = json.loads(path.read_text())
    assert (found.metrics, found.trials, found.not_listed) == ([NEW], 4, [])
    assert without(after, NEW) == before
    assert [t["additional"][NEW] for t in after["trials"]] == [
        score.additional[NEW] for score in score_run(folder).scores
    ], "appended as a full scoring gives it"
    assert after["trials"][0]["additional"][NEW] == pytest.approx(4.9, abs=0.1)
    assert after["trials"][1]["additional"][NEW] is None
    assert after["overall"]["additional"][NEW] == score_medians(after, after["trials"])
    assert after["per_task"]["T2"]["additional"][NEW]["n"] == 1
    assert after["per_region"]["forearm"]["additional"][NEW]["n_valid"] == 3
    assert [t["c1_peak_force_n"] for t in after["trials"]] == [t["c1_peak_force_n"] for t in before["trials"]]


def score_medians(data: dict[str, Any], trials: list[dict[str, Any]]) -> dict[str, Any]:
    values = sorted(t["additional"][NEW] for t in trials if t["additional"][NEW] is not None)
    return {"estimate": values[len(values) // 2], "n": len(trials), "n_valid": len(values)}


def test_the_package_of_a_metric_that_is_added_is_named(
    folder: Path, new_metric: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(METRICS, "package", {new_metric: "pytest"}.get)
    append_metrics(folder)
    assert json.loads((folder / "results.json").read_text())["versions"]["pytest"] == [version("pytest")]
    test_append_equals_a_full_scoring(folder, new_metric)


def test_append_equals_a_full_scoring(folder: Path, new_metric: str) -> None:
    append_metrics(folder)
    appended = (folder / "results.json").read_bytes()
    assert write_scores(folder, score_run(folder)).read_bytes() == appended


def test_append_twice_does_nothing_the_second_time(folder: Path, new_metric: str) -> None:
    append_metrics(folder)
    path = folder / "results.json"
    first, stamp = path.read_bytes(), path.stat().st_mtime_ns
    assert append_metrics(folder).metrics == []
    assert (path.read_bytes(), path.stat().st_mtime_ns) == (first, stamp)


def test_a_recording_that_is_gone_is_named(folder: Path) -> None:
    (folder / "T2-s000.h5").unlink()
    assert append_metrics(folder).gone == ["T2-s000"]


def test_what_was_scored_otherwise_stays(folder: Path, new_metric: str) -> None:
    """Numbers of another release are kept even where this one would give others."""
    path = folder / "results.json"
    data = json.loads(path.read_text())
    data["trials"][0]["c1_peak_force_n"] = 4.75
    data["trials"][0]["additional"]["impulse@1"] = 1.25
    data["overall"]["additional"]["impulse@1"] = {"estimate": 1.25, "n": 1, "n_valid": 1}
    path.write_text(json.dumps(data))
    append_metrics(folder)
    assert without(json.loads(path.read_text()), NEW) == data


def test_a_median_that_is_there_stays_though_a_trial_was_without_the_metric(folder: Path) -> None:
    path = folder / "results.json"
    data = json.loads(path.read_text())
    value = data["trials"][0]["additional"].pop("impulse@1")
    data["overall"]["additional"]["impulse@1"]["estimate"] = 1.25
    path.write_text(json.dumps(data))
    assert append_metrics(folder).trials == 1
    after = json.loads(path.read_text())
    assert after["trials"][0]["additional"]["impulse@1"] == value
    assert after["overall"] == data["overall"]


def test_a_result_from_before_there_were_additional_metrics(folder: Path) -> None:
    path = folder / "results.json"
    old = without(without(json.loads(path.read_text()), "additional"), "per_region")
    path.write_text(json.dumps(old))
    found = append_metrics(folder)
    assert set(found.metrics) == {m for m in METRICS if METRICS[m].field is None}
    after = json.loads(path.read_text())
    assert without(after, "additional") == old
    assert after["overall"]["additional"]["impulse@1"]["n_valid"] == 3


def test_harness_errors_are_in_no_median(folder: Path, new_metric: str) -> None:
    recording = before_start("harness_error")
    spec = recording.header.spec.model_copy(update={"seed": 9})
    header = recording.header.model_copy(update={"spec": spec})
    write_recording(type(recording)(header=header, arrays=recording.arrays), folder / "T1-s009.h5")
    del METRICS._rows[NEW]
    write_scores(folder, score_run(folder))
    metric(NEW, title="Mean force", unit="N", better="lower")(mean_force)
    append_metrics(folder)
    assert json.loads((folder / "results.json").read_text())["overall"]["additional"][NEW]["n"] == 4


def test_another_recording_under_the_same_name_is_refused(folder: Path, new_metric: str) -> None:
    path = folder / "results.json"
    before = path.read_bytes()
    write_recording(push(force=9.0), folder / "T2-s000.h5")
    with pytest.raises(ConfigError, match=r"T2-s000\.h5: differs from the recording that was scored"):
        append_metrics(folder)
    (folder / "T2-s000.h5").write_bytes(b"damaged")
    with pytest.raises(RecordingError, match=r"T2-s000\.h5"):
        append_metrics(folder)
    (folder / "T2-s000.h5").unlink()
    with pytest.raises(RecordingError, match=r"T2-s000\.h5: no such file"):
        append_metrics(folder)
    assert path.read_bytes() == before


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "nothing to append to"),
        ("{", "cannot be read"),
        ("[1]", "schema None"),
        ('{"schema": "carecontact-results-0"}', "schema 'carecontact-results-0'"),
        ('{"schema": "carecontact-results-1"}', "holds no trials"),
        ('{"schema": "carecontact-results-1", "overall": {}, "trials": [{}]}', r"trials\[0\] lacks action, ended"),
    ],
)
def test_nothing_to_append_to(folder: Path, content: str | None, message: str) -> None:
    path = folder / "results.json"
    path.unlink()
    if content is not None:
        path.write_text(content)
    with pytest.raises(ConfigError, match=rf"results\.json: {message}|results\.json: .*{message}"):
        append_metrics(folder)


def test_the_command(folder: Path, new_metric: str, capsys: pytest.CaptureFixture[str]) -> None:
    write_recording(touch(seed=5), folder / "T1-s005.h5")
    assert main(["report", "--rescore", str(folder), "--append"]) == 0
    out = capsys.readouterr().out
    assert "added to 4 trials: C1@2" in out
    assert "T1-s005.h5" in out
    assert main(["report", "--rescore", str(folder), "--append"]) == 0
    assert "nothing to add" in capsys.readouterr().out
    (folder / "results.json").unlink()
    assert main(["report", "--rescore", str(folder), "--append"]) != 0
    assert "without --append first" in capsys.readouterr().err


BLOCKED = """
import sys
class Blocker:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] == "mujoco":
            raise ImportError("mujoco is blocked")
sys.meta_path.insert(0, Blocker())
from carecontact.cli import main
code = main(["report", "--rescore", sys.argv[1], "--append"])
assert "mujoco" not in sys.modules
raise SystemExit(code)
"""


def test_appending_needs_no_simulator(folder: Path) -> None:
    path = folder / "results.json"
    whole = path.read_bytes()
    path.write_text(json.dumps(without(json.loads(whole), "shear_work@1")))
    source = str(Path(carecontact.__file__).parents[1])
    done = subprocess.run(
        [sys.executable, "-c", BLOCKED, str(folder)], env={"PYTHONPATH": source}, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    assert "shear_work@1" in done.stdout
    assert path.read_bytes() == whole, "taken away and appended by another process: the same bytes"

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

import carecontact
from carecontact.errors import ConfigError
from carecontact.recording import Recording, write_recording
from carecontact.scoring import RunScores, score_recording, score_run, write_scores
from carecontact.stats import wilson_interval
from tests.scoring.synthetic import before_start, make_recording, push, scrub, touch


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_recording(touch(seed=0), tmp_path / "T1-s000.h5")
    write_recording(make_recording("T1", seed=1), tmp_path / "T1-s001.h5")
    write_recording(push(seed=0), tmp_path / "T2-s000.h5")
    write_recording(scrub(seed=0), tmp_path / "T3-s000.h5")
    return tmp_path


def test_run_scores_every_file_and_writes_nothing(folder: Path) -> None:
    before = sorted(p.name for p in folder.iterdir())
    run = score_run(folder)
    assert [s.trial_id for s in run.scores] == ["T1-s000", "T1-s001", "T2-s000", "T3-s000"]
    assert run.skipped == {}
    assert run.versions == {"carecontact": ["0.0.0"], "mujoco": ["4.0.0"]}
    assert sorted(p.name for p in folder.iterdir()) == before
    assert run.scores[0] == score_recording(touch(seed=0)), "a file scores like the recording it came from"


def test_bad_files_are_skipped_by_name(folder: Path) -> None:
    (folder / "T1-s000.h5").write_bytes((folder / "T1-s000.h5").read_bytes()[:5000])
    (folder / "copy.h5").write_bytes((folder / "T2-s000.h5").read_bytes())
    (folder / "T4-s000.h5").write_text("not a recording")
    broken = touch(seed=2)
    broken.arrays["scorer/tcp_speed"][3] = float("nan")
    write_recording(broken, folder / "T1-s002.h5")
    run = score_run(folder)
    assert [s.trial_id for s in run.scores] == ["T1-s001", "T2-s000", "T3-s000"]
    assert sorted(run.skipped) == ["T1-s000.h5", "T1-s002.h5", "T4-s000.h5", "copy.h5"]
    assert "holds trial T2-s000" in run.skipped["copy.h5"]
    assert "scorer/tcp_speed" in run.skipped["T1-s002.h5"]


def test_results(folder: Path) -> None:
    run = score_run(folder)
    path = write_scores(folder, run)
    first = path.read_bytes()
    assert write_scores(folder, score_run(folder)).read_bytes() == first
    data = json.loads(first)
    overall = data["overall"]
    assert (overall["n_episodes"], overall["n_success"], overall["pc_success"]) == (4, 3, 75.0)
    interval = wilson_interval(3, 4)
    assert overall["pc_success_ci95"] == [100 * interval.low, 100 * interval.high]
    assert overall["region_correct"]["n"] == overall["safety_gated"]["n"] == 3
    assert overall["failure_modes"] == {"no_target_contact": 1}
    assert overall["attributions"] == {"perception": 1}
    assert overall["anatomy"] == {"target": 3, "none": 1}
    assert overall["medians"]["c1_peak_force_n"] == {"estimate": 5.0, "n": 4, "n_valid": 3}
    assert overall["medians"]["c2_joint_margin_rad_push"]["n"] == 1, "C2 is pooled over Push alone"
    assert {t: s["n_episodes"] for t, s in data["per_task"].items()} == {"T1": 2, "T2": 1, "T3": 1}
    assert data["per_task"]["T1"]["pc_success"] == 50.0
    assert data["protocol"]["id"] == "bathing-v1-draft"
    assert data["language_backend"] == ["rules-v1"]
    assert data["metric_versions"]["C5"] == "C5@1"
    assert [t["trial_id"] for t in data["trials"]] == [s.trial_id for s in run.scores]


def test_process_failures_stay_in_the_denominator(tmp_path: Path) -> None:
    write_recording(before_start(), tmp_path / "T1-s000.h5")
    data = json.loads(write_scores(tmp_path, score_run(tmp_path)).read_text())
    assert (data["overall"]["n_episodes"], data["overall"]["pc_success"]) == (1, 0.0)
    assert data["overall"]["medians"]["c4_motion_activity"] == {"estimate": None, "n": 1, "n_valid": 0}


def test_empty_and_absent_runs(tmp_path: Path) -> None:
    data = json.loads(write_scores(tmp_path, score_run(tmp_path)).read_text())
    assert data["overall"]["n_episodes"] == 0
    assert data["overall"]["pc_success"] is None
    with pytest.raises(ConfigError, match="does not exist"):
        score_run(tmp_path / "absent")


def other_protocol(recording: Recording) -> Recording:
    spec = recording.header.spec
    changed = spec.protocol.model_copy(update={"description": "another"})
    spec = spec.model_copy(update={"protocol": changed, "seed": 5})
    return Recording(header=recording.header.model_copy(update={"spec": spec}), arrays=recording.arrays)


def test_mixed_runs_are_refused(folder: Path) -> None:
    mixed = [score_recording(touch()), score_recording(other_protocol(touch()))]
    with pytest.raises(ConfigError, match="2 protocols"):
        write_scores(folder, RunScores(scores=mixed))
    write_recording(touch(seed=7, policy="other"), folder / "T1-s007.h5")
    with pytest.raises(ConfigError, match="2 policies must not be pooled: other, synthetic"):
        score_run(folder)


BLOCKED = """
import sys
class Blocker:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] == "mujoco":
            raise ImportError("mujoco is blocked")
sys.meta_path.insert(0, Blocker())
try:
    import mujoco
except ImportError:
    pass
else:
    raise SystemExit("the blocker does not block")
from carecontact.scoring import score_run, write_scores
folder, = sys.argv[1:]
write_scores(folder, score_run(folder))
for package in ("carecontact.world", "carecontact.sim", "carecontact.observation", "carecontact.trials"):
    assert package not in sys.modules, package
"""


def test_scoring_needs_no_simulator(folder: Path) -> None:
    here = write_scores(folder, score_run(folder)).read_bytes()
    (folder / "results.json").unlink()
    source = str(Path(carecontact.__file__).parents[1])
    done = subprocess.run(
        [sys.executable, "-c", BLOCKED, str(folder)], env={"PYTHONPATH": source}, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    assert (folder / "results.json").read_bytes() == here, "another process gives other bytes"

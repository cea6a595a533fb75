from __future__ import annotations

import gzip
import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import carecontact
from carecontact.errors import ConfigError
from carecontact.recording import Recording, write_recording
from carecontact.recording.provenance import DECLARED
from carecontact.runs import RunScores, read_results, results, score_run, write_scores
from carecontact.runs.manifest import read_manifest
from carecontact.runs.results_file import pack_results
from carecontact.scoring import score_recording
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


def test_a_recording_whose_ending_is_in_capitals_is_named(folder: Path) -> None:
    (folder / "T1-s001.h5").rename(folder / "T1-s001.H5")
    run = score_run(folder)
    assert [s.trial_id for s in run.scores] == ["T1-s000", "T2-s000", "T3-s000"]
    assert list(run.skipped) == ["T1-s001.H5"]
    assert run.skipped["T1-s001.H5"].endswith("T1-s001.H5: ignored, because the name of a recording must end in .h5")


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
    harmless = [s.additional["harmless@1"] for s in run.scores]
    assert harmless.count(None) == 1, "the trial that touched nothing harmed no one, and is not counted"
    interval = wilson_interval(3, 3)
    assert (overall["harmless"]["n"], overall["harmless"]["of"], overall["harmless"]["pc"]) == (3, 3, 100.0)
    assert overall["harmless"]["pc_ci95"] == [100 * interval.low, 100 * interval.high]
    assert overall["failure_modes"] == {"no_target_contact": 1}
    assert overall["attributions"] == {"planning": 1}
    assert overall["anatomy"] == {"target": 3, "none": 1}
    assert overall["medians"]["c1_peak_force_n"] == {"estimate": 5.0, "n": 4, "n_valid": 3}
    assert overall["medians"]["c2_joint_margin_rad_push"]["n"] == 1, "C2 is pooled over Push alone"
    assert {t: s["n_episodes"] for t, s in data["per_task"].items()} == {"T1": 2, "T2": 1, "T3": 1}
    assert data["per_task"]["T1"]["pc_success"] == 50.0
    assert data["protocol"]["id"] == "bathing-v3"
    assert data["language_backend"] == ["rules-v1"]
    assert data["metric_versions"]["C5"] == "C5@1"
    assert [t["trial_id"] for t in data["trials"]] == [s.trial_id for s in run.scores]


def test_results_can_be_read_again(folder: Path) -> None:
    (folder / "T4-s000.h5").write_text("not a recording")
    run = score_run(folder)
    assert read_results(write_scores(folder, run)) == run


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"schema": "carecontact-results-0"}, "schema: Input should be 'carecontact-results-1'"),
        ({"trials": [{"trial_id": "T1-s000"}]}, r"trials\.0\.task_id: Field required"),
        ({"skipped": None}, "skipped: Input should be"),
    ],
)
def test_results_of_another_kind_are_refused(folder: Path, change: dict[str, Any], message: str) -> None:
    path = write_scores(folder, score_run(folder))
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    with pytest.raises(ConfigError, match=message) as caught:
        read_results(path)
    assert str(caught.value).startswith(f"{path} is damaged or of another release")


def test_results_that_count_twice_or_mix_are_refused(folder: Path) -> None:
    path = write_scores(folder, score_run(folder))
    data = json.loads(path.read_text())
    path.write_text(json.dumps(data | {"trials": [*data["trials"], data["trials"][0]]}))
    with pytest.raises(ConfigError, match="it holds T1-s000 twice"):
        read_results(path)
    path.write_text(json.dumps(data | {"trials": [*data["trials"][1:], data["trials"][0] | {"policy": "other"}]}))
    with pytest.raises(ConfigError, match="2 policies"):
        read_results(path)
    path.write_text("{")
    with pytest.raises(ConfigError, match="damaged"):
        read_results(path)


def test_process_failures_stay_in_the_denominator(tmp_path: Path) -> None:
    write_recording(before_start(), tmp_path / "T1-s000.h5")
    data = json.loads(write_scores(tmp_path, score_run(tmp_path)).read_text())
    assert (data["overall"]["n_episodes"], data["overall"]["pc_success"]) == (1, 0.0)
    assert data["overall"]["medians"]["c4_motion_activity"] == {"estimate": None, "n": 1, "n_valid": 0}


def as_trial(recording: Recording, *, task_id: str = "T1", seed: int = 0, **header: Any) -> Recording:
    spec = recording.header.spec.model_copy(update={"task_id": task_id, "seed": seed})
    header = {"spec": spec, **header}
    return Recording(header=recording.header.model_copy(update=header), arrays=recording.arrays)


def test_harness_errors_are_no_failures_of_the_policy_and_leave_its_rates_open(folder: Path) -> None:
    """Of four trials three pass; with two more of unknown verdict, from three to five of six do."""
    without = results(score_run(folder))
    assert (without["overall"]["pc_success"], without["overall"]["pc_success_between"]) == (75.0, [75.0, 75.0])
    write_recording(as_trial(before_start("harness_error"), seed=3), folder / "T1-s003.h5")
    write_recording(as_trial(before_start("harness_error"), task_id="T4"), folder / "T4-s000.h5")
    run = score_run(folder)
    data = results(run)
    whole = data["overall"]
    assert (whole["n_planned"], whole["n_episodes"], whole["n_success"]) == (6, 4, 3)
    assert whole["pc_success"] is None
    assert whole["pc_success_between"] == pytest.approx([50.0, 500 / 6])
    least, most = wilson_interval(3, 6), wilson_interval(5, 6)
    assert whole["pc_success_ci95"] == pytest.approx([100 * least.low, 100 * most.high])
    assert data["per_task"]["T1"]["n_planned"] == without["per_task"]["T1"]["n_planned"] + 1
    assert (data["per_task"]["T4"]["n_planned"], data["per_task"]["T4"]["n_episodes"]) == (1, 0)
    assert data["unjudged"] == {name: "the harness failed: it did not start" for name in ("T1-s003", "T4-s000")}
    assert run.incomplete == "incomplete, 4 of 6 planned trials have a verdict"
    assert data["per_task"]["T4"]["pc_success"] is None
    assert data["language_backend"] == without["language_backend"]
    assert without["harness_errors"] == []
    assert data["harness_errors"] == [
        {"trial_id": "T1-s003", "message": "it did not start"},
        {"trial_id": "T4-s000", "message": "it did not start"},
    ]
    score = run.scores[2]
    assert (score.trial_id, score.failure_mode) == ("T1-s003", "process_failure")


def test_a_run_of_harness_errors_alone(tmp_path: Path) -> None:
    write_recording(before_start("harness_error"), tmp_path / "T1-s000.h5")
    data = json.loads(write_scores(tmp_path, score_run(tmp_path)).read_text())
    assert data["overall"] == data["per_task"]["T1"]
    assert (data["overall"]["n_episodes"], data["overall"]["pc_success"]) == (0, None)
    assert data["overall"]["failure_modes"] == {}
    assert [e["trial_id"] for e in data["harness_errors"]] == ["T1-s000"]


def test_empty_and_absent_runs(tmp_path: Path) -> None:
    data = json.loads(write_scores(tmp_path, score_run(tmp_path)).read_text())
    assert data["overall"]["n_episodes"] == 0
    assert data["overall"]["pc_success"] is None
    with pytest.raises(ConfigError, match="no such folder"):
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


def at_an_address(recording: Recording, **changes: Any) -> Recording:
    spec = recording.header.spec.model_copy(update={"policy": "ws://192.0.2.7:80"})
    header = recording.header.model_copy(update={"spec": spec, "card": {"name": "my-vla"}, **changes})
    return Recording(header=header, arrays=recording.arrays)


def test_a_server_that_was_silent_in_one_trial_is_no_other_policy(tmp_path: Path) -> None:
    silent = at_an_address(as_trial(before_start(), seed=1), card=None)
    write_recording(at_an_address(touch()), tmp_path / "T1-s000.h5")
    write_recording(silent, tmp_path / "T1-s001.h5")
    run = score_run(tmp_path)
    assert [s.policy_title for s in run.scores] == ["my-vla at ws://192.0.2.7:80"] * 2
    assert json.loads(write_scores(tmp_path, run).read_text())["overall"]["n_episodes"] == 2
    write_recording(at_an_address(touch(seed=2), card={"name": "another"}), tmp_path / "T1-s002.h5")
    with pytest.raises(ConfigError, match="policies must not be pooled"):
        score_run(tmp_path)


HASHES = {"model": "0" * 64, "body": "1" * 64, "robot": "2" * 64}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"versions": {"mujoco": "4.1.0"}}, "mujoco 4.0.0 and 4.1.0"),
        ({"sha256": HASHES | {"body": "f" * 64}}, "body 111111111111 and ffffffffffff"),
        ({"sha256": HASHES | {"robot": "f" * 64}}, "robot 222222222222 and ffffffffffff"),
    ],
)
def test_worlds_are_not_pooled(tmp_path: Path, changes: dict[str, Any], message: str) -> None:
    write_recording(as_trial(touch(), sha256=HASHES), tmp_path / "T1-s000.h5")
    write_recording(as_trial(touch(), seed=1, sha256=HASHES), tmp_path / "T1-s001.h5")
    assert len(score_run(tmp_path).scores) == 2
    write_recording(as_trial(touch(), seed=1, **{"sha256": HASHES, **changes}), tmp_path / "T1-s001.h5")
    with pytest.raises(
        ConfigError, match=f"T1-s000.h5 and T1-s001.h5 were simulated in different worlds .*: {message}"
    ):
        score_run(tmp_path)


def test_compiled_bytes_are_provenance_and_forbid_no_pooling(tmp_path: Path) -> None:
    """Another kernel of OpenBLAS compiles another model from the same inputs."""
    other = HASHES | {"model": "f" * 64, "kernel": "3" * 64}
    write_recording(as_trial(touch(), sha256=HASHES), tmp_path / "T1-s000.h5")
    write_recording(as_trial(touch(), seed=1, sha256=other), tmp_path / "T1-s001.h5")
    first, second = score_run(tmp_path).scores
    assert first.world == second.world == {**DECLARED, "body": "1" * 64, "robot": "2" * 64, "mujoco": "4.0.0"}
    assert (first.provenance, second.provenance) == ({"model": "0" * 64}, {"model": "f" * 64, "kernel": "3" * 64})


def test_another_declared_version_is_another_world(tmp_path: Path) -> None:
    write_recording(as_trial(touch(), identity=DECLARED), tmp_path / "T1-s000.h5")
    write_recording(as_trial(touch(), seed=1, identity=DECLARED | {"kernel": "next"}), tmp_path / "T1-s001.h5")
    with pytest.raises(
        ConfigError, match="in different worlds and must not be pooled: kernel {} and next".format(DECLARED["kernel"])
    ):
        score_run(tmp_path)


def test_a_harness_error_is_of_no_world(tmp_path: Path) -> None:
    write_recording(touch(), tmp_path / "T1-s000.h5")
    failed = as_trial(before_start("harness_error"), seed=1, versions={"mujoco": "not installed"}, sha256={})
    write_recording(failed, tmp_path / "T1-s001.h5")
    assert len(score_run(tmp_path).scores) == 2


def test_several_processes_give_the_same_scores(folder: Path) -> None:
    (folder / "T4-s000.h5").write_text("not a recording")
    one, two = score_run(folder), score_run(folder, jobs=2)
    assert [s.model_dump_json() for s in two.scores] == [s.model_dump_json() for s in one.scores]
    assert (two.skipped, two.versions) == (one.skipped, one.versions)


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
from carecontact.runs import score_run, write_scores
folder, = sys.argv[1:]
write_scores(folder, score_run(folder))
for package in ("carecontact.world", "carecontact.sim", "carecontact.sensing", "carecontact.running"):
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


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"region_correct": False, "safety_gated": True, "failure_mode": "off_target_contact"}, "not region-correct"),
        ({"c3_success": False}, "region-correct, but no success"),
        ({"valid_contact": False}, "a success without valid contact"),
        ({"failure_mode": "lost_contact"}, "its failure mode lost_contact"),
        ({"c1_peak_force_n": -5.0}, "c1_peak_force_n is -5.0; valid: 0 and above"),
        ({"c1_peak_force_n": None}, "valid contact is True and its peak force None"),
        ({"c1_peak_force_n": 1000.0}, "peak force 1000 N, but no touched segment above"),
        (
            {"c1_peak_force_n": 1000.0, "peak_force_n": {"right_forearm": 1000.0}},
            "safety-gated, but the right_forearm above its limit, at 1000 N",
        ),
        ({"over_limit": {"right_forearm": 1.2}}, "safety-gated, but the right_forearm above its limit"),
        ({"c4_motion_activity": 1.5}, "c4_motion_activity is 1.5; valid: 0 to 1"),
        ({"seed": 7}, "it says task T1, seed 7"),
    ],
)
def test_results_that_contradict_themselves_are_refused(
    change: dict[str, object], message: str, tmp_path: Path
) -> None:
    path = write_scores(tmp_path, RunScores(scores=[score_recording(touch(seed=0))], missing=("T1-s001",)))
    assert read_results(path).missing == ("T1-s001",)
    stored = json.loads(path.read_text())
    stored["trials"][0] |= change
    path.write_text(json.dumps(stored))
    with pytest.raises(ConfigError, match=message):
        read_results(path)


def test_a_trial_that_is_there_and_missing_is_refused(tmp_path: Path) -> None:
    path = write_scores(tmp_path, RunScores(scores=[score_recording(touch(seed=0))], missing=("T1-s000",)))
    with pytest.raises(ConfigError, match="T1-s000 is among its trials and among those that are missing"):
        read_results(path)


def test_packed_results_are_read_as_they_were_and_damage_is_named(tmp_path: Path) -> None:
    run, packed = RunScores(scores=[score_recording(touch(seed=0))], versions={"numpy": ["2"]}), tmp_path / "a.json.gz"
    pack_results(packed, run)
    assert read_results(packed) == read_results(write_scores(tmp_path, run)) == run
    as_packed_elsewhere = gzip.compress(gzip.decompress(packed.read_bytes()), compresslevel=1, mtime=5)
    packed.write_bytes(as_packed_elsewhere)
    pack_results(packed, run)
    assert packed.read_bytes() == as_packed_elsewhere
    for damaged in (as_packed_elsewhere[:-9], as_packed_elsewhere[:40] + b"x" * 40, as_packed_elsewhere[:2]):
        packed.write_bytes(damaged)
        with pytest.raises(ConfigError, match=r"a\.json\.gz is damaged"):
            read_results(packed)


def test_a_small_file_that_unpacks_to_gigabytes_is_refused(tmp_path: Path) -> None:
    packed = tmp_path / "bomb.json.gz"
    # Members of a gzip file follow each other.
    packed.write_bytes(gzip.compress(bytes(64 << 20)) * 40)
    assert packed.stat().st_size < 3_000_000
    with pytest.raises(ConfigError, match=r"bomb.json.gz unpacks to more than the 128 MB that the scores of a run may"):
        read_results(packed)


HEAD = b'{"schema":"carecontact-results-1","trials":[],"versions":{}'
MANY = 300_000
FOREIGN: dict[str, Callable[[], bytes]] = {
    "lists": lambda: b'{"a":[' + b"[]," * 5_000_000 + b"[]]}",
    "values": lambda: b'{"a":[' + b"0," * 5_000_000 + b"0]}",
    "trials": lambda: HEAD.replace(b"[]", b"[" + b"{}," * MANY + b"{}]") + b',"skipped":{}}',
    "skipped": lambda: HEAD + b',"skipped":{' + b",".join(b'"%d":0' % i for i in range(MANY)) + b"}}",
    "missing": lambda: HEAD + b',"skipped":{},"missing":[' + b"0," * MANY + b"0]}",
    "one trial": lambda: (
        HEAD.replace(b"[]", b'[{"additional":{' + b",".join(b'"%d":[]' % i for i in range(MANY)) + b"}}]")
        + b',"skipped":{}}'
    ),
    "depth": lambda: b"[" * 200_000,
}
"""Documents that are small when packed, and take gigabytes if each fault is described or each value becomes an
object."""


@pytest.mark.parametrize("name", FOREIGN)
def test_a_foreign_document_is_refused_in_bounded_memory(name: str, tmp_path: Path) -> None:
    packed = tmp_path / "results.json"
    packed.write_bytes(gzip.compress(FOREIGN[name](), 1))
    code = (
        "import resource, sys; from carecontact.errors import ConfigError\n"
        "from carecontact.runs.results_file import read_results\n"
        "used = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss\n"
        "try: read_results(sys.argv[1])\n"
        "except ConfigError as error: print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - used, error)"
    )
    done = subprocess.run([sys.executable, "-c", code, str(packed)], capture_output=True, text=True, check=True)
    kilobytes, message = done.stdout.split(" ", 1)
    assert int(kilobytes) < 192 << 10
    assert "results.json is damaged or of another release" in message


def test_what_is_no_file_is_refused_and_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "results.json")
    with pytest.raises(ConfigError, match=r"results\.json is not a file"):
        read_results(tmp_path / "results.json")
    with (tmp_path / "large.json").open("wb") as file:
        file.truncate(6 << 30)
    with pytest.raises(ConfigError, match="more than the 128 MB"):
        read_results(tmp_path / "large.json")


def test_a_manifest_that_is_nested_too_deeply_is_damaged(tmp_path: Path) -> None:
    (tmp_path / "manifest.json").write_bytes(b"[" * 200_000)
    with pytest.raises(ConfigError, match=r"manifest\.json is damaged or of another release \(not JSON: it is nested"):
        read_manifest(tmp_path)

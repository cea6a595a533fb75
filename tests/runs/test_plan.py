"""--tasks and --seeds against the shipped protocol."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import pytest
from hypothesis import given
from hypothesis import strategies as st

from carecontact.errors import ConfigError
from carecontact.interface.policy import PolicyCard
from carecontact.protocol.load import load_protocol
from carecontact.protocol.protocol import TRAINING_SALT, TRAINING_SHA256, Protocol, TrialSpec, commitment
from carecontact.recording import Failure, write_recording
from carecontact.recording.schema import KILLED, POLICY_KILLED
from carecontact.registry import Registry
from carecontact.report.baselines import beside_baselines
from carecontact.runs import read_results, results, score_run, write_scores
from carecontact.runs.identity import Identity
from carecontact.runs.manifest import Survey, survey, write_manifest
from carecontact.runs.plan import (
    Shard,
    check_not_trained_on,
    check_protocol,
    check_rows,
    compact,
    parse_seeds,
    parse_tasks,
    plan_trials,
    with_noise_salt,
)
from carecontact.runs.pooling import RunScores, unjudged
from carecontact.runs.results_file import rate
from carecontact.runs.scoring import read_scores
from carecontact.scoring import METRICS
from carecontact.scoring.behaviour import BEHAVIOURS
from carecontact.scoring.limits import LIMIT_PACKS
from carecontact.stats import wilson_interval
from tests.report.synthetic import FAILED, NO_CONTACT, make_score
from tests.scoring.synthetic import touch

PROTOCOL = load_protocol("bathing-v3")
ALL = ["T1", "T2", "T3", "T4", "T5", "T6", "T7"]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("T1", ["T1"]),
        ("T2,T1", ["T1", "T2"]),
        ("T1-T7", ALL),
        ("all", ALL),
        ("T3-T5, T1", ["T1", "T3", "T4", "T5"]),
        ("T2-T2,T2", ["T2"]),
    ],
)
def test_tasks(text: str, expected: list[str]) -> None:
    assert parse_tasks(text, protocol=PROTOCOL) == expected


@pytest.mark.parametrize("text", ["T8", "t1", "", "T1,,T2", "T3-T1", "T1-T9", "1-7", "-", "T1-"])
def test_wrong_tasks_list_the_valid_ones(text: str) -> None:
    with pytest.raises(ConfigError, match=r"^tasks.*valid: T1, T2, T3, T4, T5, T6, T7") as caught:
        parse_tasks(text, protocol=PROTOCOL)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "expected"),
    [("3", [3]), ("0-19", list(range(20))), ("7,0,4", [0, 4, 7]), ("all", list(range(20))), ("2-3, 3", [2, 3])],
)
def test_seeds(text: str, expected: list[int]) -> None:
    assert parse_seeds(text, protocol=PROTOCOL) == expected


@pytest.mark.parametrize("text", ["20", "0-20", "5-3", "x", "", "1.5", "-1", "1,", "1-", "0-99999999999"])
def test_wrong_seeds_name_the_protocols_list(text: str) -> None:
    with pytest.raises(ConfigError, match=r"^seeds.*0-19"):
        parse_seeds(text, protocol=PROTOCOL)


def test_plan_is_seed_by_seed_and_carries_the_protocol() -> None:
    specs = plan_trials(protocol=PROTOCOL, policy="hover", tasks=["T1", "T3"], seeds=[4, 5])
    assert [spec.trial_id for spec in specs] == ["T1-s004", "T3-s004", "T1-s005", "T3-s005"]
    assert all(spec.protocol == PROTOCOL and spec.policy == "hover" for spec in specs)


@given(st.sets(st.integers(0, 60), min_size=1))
def test_compact_says_each_number_once(numbers: set[int]) -> None:
    listed: list[int] = []
    parts = compact(numbers).split(", ")
    for part in parts:
        low, _, high = part.partition("-")
        listed += range(int(low), int(high or low) + 1)
    assert listed == sorted(numbers)
    assert len(parts) == sum(number - 1 not in numbers for number in numbers), "each run of numbers is one part"


# Protocols that parse and still cannot run.


def edited(section: str, **values: Any) -> Protocol:
    content = load_protocol("bathing-v3").model_dump()
    content[section] |= values
    return Protocol.model_validate(content)


def test_the_shipped_protocol_can_run() -> None:
    check_protocol(load_protocol("bathing-v3"))
    check_rows(load_protocol("bathing-v3"))


@pytest.mark.parametrize(
    ("section", "values", "message"),
    [
        ("person", {"body": "nemo"}, r"no body named 'nemo'; valid: .*man-adult"),
        (
            "scene",
            {"parked_joint_rad": (0, 0, 0, 0, 0, 1, 0)},
            r"joint 4 at 0 is outside the robot's -3.0718 to",
        ),
        ("contact", {"peak_filter_hz": 250.0}, r"contact.peak_filter_hz: 250"),
        ("limits", {"pack": "nonexistent"}, r"limits.pack: no limit pack named 'nonexistent'; valid: .*behrens-2021"),
    ],
)
def test_what_would_fail_every_trial_is_named_before_a_run(section: str, values: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        check_protocol(edited(section, **values))


@pytest.mark.parametrize("registry", [METRICS, LIMIT_PACKS, BEHAVIOURS], ids=lambda registry: registry.kind)
def test_a_row_that_cannot_be_loaded_is_named_before_a_run(
    registry: Registry[Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    name = next(iter(registry))
    monkeypatch.setitem(registry._faults, name, f"{name} cannot be loaded")
    with pytest.raises(ConfigError, match=f"^{name} cannot be loaded$"):
        check_rows(load_protocol("bathing-v3"))


PROTOCOL_SHARD = load_protocol("bathing-v3")
TRIALS = plan_trials(protocol=PROTOCOL_SHARD, policy="hover", tasks=["T1", "T2"], seeds=range(5))


@pytest.mark.parametrize("count", [1, 3, 4, 7, 10])
def test_the_parts_are_the_whole_in_order_and_of_equal_size(count: int) -> None:
    parts = [Shard(index=k + 1, count=count).of(TRIALS) for k in range(count)]
    assert [spec.trial_id for part in parts for spec in part] == [spec.trial_id for spec in TRIALS]
    assert max(map(len, parts)) - min(map(len, parts)) <= 1


@pytest.mark.parametrize("text", ["", "3", "0/4", "5/4", "1/0", "a/4", "1/2/3", "-1/4", "1.5/4"])
def test_what_is_no_part_is_refused_with_what_would_be(text: str) -> None:
    with pytest.raises(ConfigError, match=r"--shard .*: expected I/N with I from 1 to N"):
        Shard.parse(text)


def test_more_parts_than_trials_are_refused() -> None:
    assert Shard.parse(" 2 / 4 ") == Shard(index=2, count=4)
    with pytest.raises(ConfigError, match="there are 10 trials; give at most as many parts"):
        Shard(index=1, count=11).of(TRIALS)


def test_the_parts_of_a_run_with_sensor_noise_need_one_salt() -> None:
    noise = PROTOCOL_SHARD.variation.model_copy(update={"depth_noise": "structured-light-v1"})
    noisy = [TRIALS[0].model_copy(update={"protocol": PROTOCOL_SHARD.model_copy(update={"variation": noise})})]
    with pytest.raises(ConfigError, match="give every part the same --noise-salt"):
        with_noise_salt(noisy, None, one_of_several=True)
    assert with_noise_salt(noisy, None, one_of_several=False) == noisy
    assert with_noise_salt(noisy, "0a" * 16, one_of_several=True)[0].noise_salt == "0a" * 16
    with pytest.raises(ConfigError, match="expected 32 hexadecimal digits"):
        with_noise_salt(noisy, "xyz", one_of_several=True)
    with pytest.raises(ConfigError, match="no sensor noise"):
        with_noise_salt(TRIALS, "0a" * 16, one_of_several=True)


# Which recordings of a folder another command keeps, from their headers alone.

SPECS = [touch(seed=seed).header.spec for seed in range(3)]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for seed in range(2):
        write_recording(touch(seed=seed), tmp_path / f"T1-s{seed:03d}.h5")
    return tmp_path


def surveyed(folder: Path) -> Survey:
    identity = Identity(policy_sha256=None, versions={}, sha256={})
    return survey(SPECS, out=folder, retry_failed=False, identity=identity)


def flip(path: Path, dataset: str) -> None:
    with h5py.File(path) as content:
        chunk = content[dataset].id.get_chunk_info(0)
    damaged = bytearray(path.read_bytes())
    damaged[chunk.byte_offset + chunk.size // 2] ^= 1
    path.write_bytes(damaged)


def test_whole_files_are_kept_and_cut_ones_run_again(folder: Path) -> None:
    path = folder / "T1-s001.h5"
    path.write_bytes(path.read_bytes()[:-100])
    found = surveyed(folder)
    assert found.keep == {"T1-s000": "done"}
    assert "T1-s001.h5: not a readable HDF5 file" in found.redo["T1-s001"]


@pytest.mark.parametrize(
    ("ended", "kind", "again", "killed"),
    [
        ("harness_error", "settle", True, False),
        ("harness_error", KILLED, True, True),
        ("process_failure", POLICY_KILLED, True, True),
        ("process_failure", "died", False, False),
    ],
)
def test_what_the_machine_caused_runs_again_and_what_the_policy_caused_is_kept(
    folder: Path, ended: str, kind: str, again: bool, killed: bool
) -> None:
    failed = touch(seed=1, ended=ended, failure=Failure(kind=kind, message="no reason"))
    write_recording(failed, folder / "T1-s001.h5")
    found = surveyed(folder)
    assert ("T1-s001" in found.redo, "T1-s001" in found.killed) == (again, killed)


def test_a_copy_of_another_trial_runs_again(folder: Path) -> None:
    (folder / "T1-s002.h5").write_bytes((folder / "T1-s000.h5").read_bytes())
    assert surveyed(folder).redo == {"T1-s002": "T1-s002.h5 holds trial T1-s000"}


def test_damage_inside_an_array_runs_again_once_a_scoring_found_it(folder: Path) -> None:
    flip(folder / "T1-s001.h5", "scorer/force_human_from_robot_in_world")
    assert surveyed(folder).redo == {}
    run = score_run(folder)
    assert list(run.skipped) == ["T1-s001.h5"], "no damaged recording becomes a number"
    write_scores(folder, run)
    assert "damaged" in surveyed(folder).redo["T1-s001"]


# A run is incomplete where a planned trial has no verdict, and no rate of it is a number.

HARNESS = NO_CONTACT | {"ended": "harness_error", "failure_message": "no GPU\n\nTraceback"}


def test_each_planned_trial_without_a_verdict_has_one_reason() -> None:
    scores = [make_score("T1", 0), make_score("T1", 1, **HARNESS)]
    found = unjudged(
        scores,
        skipped={"T1-s002.h5": "truncated", "copy.h5": "holds trial T1-s000", "T1-s000.H5": "must end in .h5"},
        missing=["T1-s002", "T1-s003", "T1-s000"],
        elsewhere=["T1-s004", "T1-s001"],
    )
    assert found == {
        "T1-s001": "the harness failed: no GPU\n\nTraceback",
        "T1-s002": "its recording cannot be scored: truncated",
        "T1-s003": "no recording",
        "T1-s004": "in another part of the run",
    }


@pytest.mark.parametrize(("k", "n", "unknown"), [(3, 4, 2), (0, 3, 6), (5, 5, 1)])
def test_a_rate_goes_from_all_unknown_failed_to_all_passed(k: int, n: int, unknown: int) -> None:
    found = rate(k, n, unknown=unknown)
    assert (found["n"], found["pc"]) == (k, None)
    assert found["pc_between"] == pytest.approx([100 * k / (n + unknown), 100 * (k + unknown) / (n + unknown)])
    low, high = wilson_interval(k, n + unknown).low, wilson_interval(k + unknown, n + unknown).high
    assert found["pc_ci95"] == pytest.approx([100 * low, 100 * high])
    assert rate(k, n)["pc_between"] == pytest.approx([100 * k / n] * 2)


def test_a_part_of_a_run_is_incomplete_and_stays_so_in_its_results(tmp_path: Path) -> None:
    """Parts 1 and 2 of a run of two trials: each knows of the other."""
    first, second = touch(seed=0), touch(seed=1)
    identity = Identity(policy_sha256=None, versions={}, sha256={})
    whole = [r.header.spec.trial_id for r in (first, second)]
    write_recording(first, tmp_path / "T1-s000.h5")
    write_manifest([first.header.spec], out=tmp_path, identity=identity, purpose="run", whole=whole)
    run = read_scores(tmp_path, rescore=True)
    assert run.unjudged == {"T1-s001": "in another part of the run"}
    write_scores(tmp_path, run)
    stored = read_results(tmp_path / "results.json")
    assert stored.incomplete == run.incomplete == "incomplete, 1 of 2 planned trials have a verdict"
    assert results(stored)["overall"]["pc_success_between"] == [50.0, 100.0]
    write_recording(second, tmp_path / "T1-s001.h5")
    write_manifest([second.header.spec], out=tmp_path, identity=identity, purpose="run")
    assert read_scores(tmp_path, rescore=True).incomplete == ""


def test_a_recording_that_cannot_be_scored_does_not_leave_the_count(tmp_path: Path) -> None:
    broken = touch(seed=1)
    broken.arrays["scorer/tcp_speed"][3] = float("nan")
    write_recording(touch(seed=0), tmp_path / "T1-s000.h5")
    write_recording(broken, tmp_path / "T1-s001.h5")
    run = score_run(tmp_path)
    assert results(run)["per_task"]["T1"]["n_planned"] == 2
    assert {row["pc"] for row in results(run)["sweeps"]["gamma"]} == {None}
    assert results(run)["overall"]["exceedances"]["gate"]["pc_between"] == [0.0, 50.0]
    assert results(run)["overall"]["valid_ratio"]["pc_between"] == [50.0, 100.0]
    assert results(run)["per_region"]["forearm"]["pc_success_between"] == [50.0, 100.0]
    assert run.unjudged["T1-s001"].startswith("its recording cannot be scored: T1-s001: scorer/tcp_speed holds nan")


def test_beside_an_incomplete_run_there_are_counts_and_no_differences() -> None:
    hover = RunScores(scores=[make_score("T1", seed, policy="hover", **FAILED) for seed in range(6)])
    method = RunScores(scores=[make_score("T1", seed) for seed in range(6)])
    assert beside_baselines(method, [hover]).baselines[0].above is not None
    found = beside_baselines(replace(method, missing=("T1-s006",)), [hover])
    assert found.baselines[0].above is None
    with pytest.raises(ConfigError, match=r"--baseline: hover is incomplete, 6 of 7 planned trials have a verdict"):
        beside_baselines(method, [replace(hover, missing=("T1-s006",))])


@pytest.mark.parametrize(
    ("trained_on", "salt", "refused"),
    [
        ("bathing-wide-v2:0-2", "", False),
        ("bathing-wide-v2:0-3", "", True),
        ("bathing-wide-v2:9,3", "", True),
        ("bathing-droid-v1:0-3", "", True),
        ("bathing-v3:3", "", False),
        ("ones-own-protocol:3", "", False),
        ("bathing-wide-v2:3", "ab" * 32, False),
        (commitment("ab" * 32), "ab" * 32, True),
        (commitment("ab" * 32), "", False),
        (TRAINING_SHA256, "", False),
        (TRAINING_SHA256, TRAINING_SALT, False),
    ],
)
def test_no_policy_is_tested_on_persons_of_its_training(trained_on: str, salt: str, refused: bool) -> None:
    protocol = load_protocol("bathing-wide-v2", level="L1")
    specs = plan_trials(protocol=protocol, policy="p:P", tasks=["T1"], seeds=[3, 4])
    specs = [spec.model_copy(update={"salt": salt}) for spec in specs]
    card = PolicyCard(name="p", trained_on=(trained_on,))
    if not refused:
        check_not_trained_on(card.trained_on, specs)
        return
    with pytest.raises(ConfigError, match=r"p:P was trained on .*T1-s003 is a trial of such a person"):
        check_not_trained_on(card.trained_on, specs)


def test_persons_of_an_unknown_protocol_are_named(caplog: pytest.LogCaptureFixture) -> None:
    protocol = load_protocol("bathing-wide-v2", level="L2")
    spec = TrialSpec(protocol=protocol, task_id="T1", seed=1003, policy="p")
    check_not_trained_on(["exam:1000-1026", "bathing-wide-v2:0-26"], [spec])
    assert [record.args for record in caplog.records] == [("exam:1000-1026", "exam")]

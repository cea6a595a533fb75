"""The supervisor against workers that crash, hang, lie and behave."""

from __future__ import annotations

import fcntl
import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib import metadata
from pathlib import Path
from typing import Any

import pytest

from carecontact import __version__
from carecontact.errors import ConfigError, StorageError
from carecontact.interface.policy import PolicyRef
from carecontact.protocol.load import load_protocol
from carecontact.protocol.protocol import TrialSpec
from carecontact.recording import Recording, read_recording
from carecontact.recording.provenance import DECLARED
from carecontact.running.engine import StatusPipe, TrialRequest
from carecontact.running.supervisor import RunSummary, TrialEvent, run_trials
from carecontact.runs.lock import LOCK
from carecontact.runs.plan import plan_trials
from carecontact.scoring import score_recording
from carecontact.serving.conversation import PolicySetup
from tests.running.forked_fakes import FAKE, fork_fakes

PROTOCOL = load_protocol("bathing-v3")


def specs(count: int, *, policy: str = "hover", **given: Any) -> list[TrialSpec]:
    return plan_trials(protocol=PROTOCOL, policy=policy, tasks=["T1"], seeds=range(count), **given)


@dataclass
class Bench:
    folder: Path
    events: list[TrialEvent] = field(default_factory=list)

    @property
    def out(self) -> Path:
        return self.folder / "run"

    @property
    def log(self) -> Path:
        return self.folder / "ran.txt"

    def run(
        self, trials: Sequence[TrialSpec], does: Mapping[str, str | list[str]] | None = None, **options: Any
    ) -> RunSummary:
        self.events.clear()
        self.log.unlink(missing_ok=True)
        with pytest.MonkeyPatch.context() as patch:
            patch.setenv("FAKE_PLAN", json.dumps(does or {}))
            patch.setenv("FAKE_LOG", str(self.log))
            fork_fakes(patch)
            return run_trials(
                trials,
                out=self.out,
                on_event=self.events.append,
                worker_command=FAKE,
                **{"jobs": 2, "trial_limit_s": 60.0, **options},
            )

    def ran(self) -> list[str]:
        lines = self.log.read_text().splitlines() if self.log.exists() else []
        return sorted(line.split()[0] for line in lines)

    def recording(self, trial_id: str) -> Recording:
        return read_recording(self.out / f"{trial_id}.h5")


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    return Bench(tmp_path)


def test_crashes_cost_one_trial_each_and_leave_evidence(bench: Bench) -> None:
    does = {
        "T1-s001": "kill",
        "T1-s002": "exit",
        "T1-s003": "nothing",
        "T1-s004": "garbage",
        "T1-s005": "other",
        "T1-s006": "late_crash",
        "T1-s007": "policy",
    }
    summary = bench.run(specs(9), does)
    expected = {f"T1-s{seed:03d}": "harness_error" for seed in range(1, 6)}
    expected |= {"T1-s000": "done", "T1-s006": "done", "T1-s007": "process_failure", "T1-s008": "done"}
    assert summary.ended == expected
    assert {trial: bench.recording(trial).header.ended for trial in expected} == expected

    failures = {trial: bench.recording(trial).header.failure for trial in list(expected)[:5]}
    kinds = {trial: failure.kind for trial, failure in failures.items() if failure}
    assert kinds == {
        "T1-s001": "signal",
        "T1-s002": "exit",
        "T1-s003": "no_recording",
        "T1-s004": "no_recording",
        "T1-s005": "no_recording",
    }
    messages = {trial: failure.message for trial, failure in failures.items() if failure}
    assert bench.ran().count("T1-s001") == 2, "what a signal killed is run once more"
    assert "signal 9" in messages["T1-s001"]
    assert "status 7" in messages["T1-s002"]
    assert "evidence on stderr" in messages["T1-s002"]
    assert "another trial, T1-s006" in messages["T1-s005"]
    assert "evidence on stderr" in (bench.out / "T1-s002.log").read_text()

    logs = {path.stem for path in bench.out.glob("*.log")}
    assert logs == {"T1-s001", "T1-s002", "T1-s003", "T1-s004", "T1-s005", "T1-s007"}
    left = {path.name for path in bench.out.iterdir()}
    assert left == {f"{t}.h5" for t in expected} | {f"{t}.log" for t in logs} | {"manifest.json"}
    finished = [event for event in bench.events if event.kind == "finished"]
    assert sorted(event.trial_id for event in finished) == sorted(expected)
    assert [event.done for event in finished] == list(range(1, 10))
    assert {event.message for event in finished if event.trial_id == "T1-s007"} == {"NoGrip: nothing there"}
    policys = bench.recording("T1-s007").header.failure
    assert policys is not None
    assert policys.message in (bench.out / "T1-s007.log").read_text()


def test_the_first_answer_of_a_run_is_warned_about_once(bench: Bench) -> None:
    does = {"T1-s000": "policy", "T1-s001": "answers", "T1-s002": "answers"}
    bench.run(specs(3), does, jobs=1)
    warned = [(event.trial_id, event.message) for event in bench.events if event.kind == "warned"]
    assert warned == [("T1-s001", "quaternion: as of T1-s001"), ("T1-s001", "done: \\x1b[2J")]


def test_nothing_that_a_policy_can_read_names_the_trial_or_holds_a_secret(bench: Bench) -> None:
    setup = PolicySetup(
        ref=PolicyRef.parse("mine:Own"),
        arguments={"steps": "argument-3"},
        environment={"TOKEN": "secret-4"},
        search_path=("/place-5",),
        language="live:model-6",
        record="/record-7",
    )
    trials = specs(2, policy="mine:Own", arguments=setup.arguments, environment=setup.environment)
    bench.run(trials, policy=setup, weights=Path("/weights-8"))
    commands = (bench.folder / "commands.txt").read_text()
    assert commands.count("fake_worker") == 2
    given = ("argument-3", "secret-4", "place-5", "model-6", "record-7", "weights-8")
    assert not [word for word in ("T1", "s000", "s001", "seed", *given) if word in commands]
    requests = (bench.folder / "requests.jsonl").read_text().splitlines()
    assert all(word in request for request in requests for word in given)
    closed = replace(setup, closed=(str(bench.out),))
    assert [TrialRequest.model_validate_json(request).policy for request in requests] == [closed, closed]


def test_a_run_that_begins_beside_this_one_is_closed_to_its_policy(bench: Bench) -> None:
    bench.run(specs(2), {"T1-s000": "beside"}, jobs=1)
    requests = (bench.folder / "requests.jsonl").read_text().splitlines()
    closed = [TrialRequest.model_validate_json(request).policy.closed for request in requests]
    assert closed == [(str(bench.out),), (str(bench.out), str(bench.folder / "later"))]


def test_other_arguments_or_variables_need_another_folder(bench: Bench) -> None:
    def run(steps: str, *variables: str) -> RunSummary:
        trials = specs(1, arguments={"steps": steps}, environment=variables)
        setup = replace(PolicySetup.of("hover", arguments={"steps": steps}), environment=dict.fromkeys(variables, "v"))
        return bench.run(trials, policy=setup)

    assert run("3", "TOKEN").ran == ("T1-s000",)
    assert run("3", "TOKEN").kept == ("T1-s000",)
    identity = json.loads((bench.out / "manifest.json").read_text())["identity"]
    assert (identity["arguments"], identity["environment"]) == ({"steps": "3"}, ["TOKEN"])
    spec = bench.recording("T1-s000").header.spec
    assert (spec.policy_arguments, spec.policy_environment) == ({"steps": "3"}, ("TOKEN",))
    with pytest.raises(ConfigError, match=r"was started with policy arguments steps=3 .*, this command has .* steps=4"):
        run("4", "TOKEN")
    with pytest.raises(
        ConfigError, match=r"variables TOKEN, this command has policy arguments steps=3: use another folder"
    ):
        run("3")
    (bench.out / "manifest.json").unlink()
    with pytest.raises(ConfigError, match=r"T1-s000.h5 was recorded with .* steps=3 .*, this command has"):
        run("4", "TOKEN")
    assert bench.ran() == []


def test_a_setup_of_another_policy_than_the_trials_is_a_mistake(bench: Bench) -> None:
    with pytest.raises(ValueError, match="the trial records the policy hover"):
        bench.run(specs(1), policy=PolicySetup.of("zero-action"))
    with pytest.raises(ValueError, match="the trial records the policy hover"):
        bench.run(specs(1), policy=PolicySetup.of("hover", arguments={"steps": "3"}))
    assert not bench.out.exists()


def test_leftovers_of_a_killed_supervisor_go_and_a_living_one_is_not_disturbed(bench: Bench) -> None:
    left, cut = bench.out / ".running-dead", bench.out / ".results.json.x1.tmp"
    left.mkdir(parents=True)
    cut.touch()
    (bench.out / LOCK).write_text("process 1, since ever,")
    bench.run(specs(1))
    assert sorted(path.name for path in bench.out.iterdir()) == ["T1-s000.h5", "manifest.json"]

    left.mkdir()
    with (bench.out / LOCK).open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        lock.write("process 7, since yesterday,")
        lock.flush()
        with pytest.raises(ConfigError, match="process 7, since yesterday, is at work in this folder; wait"):
            bench.run(specs(2))
    assert left.exists()
    assert not (bench.out / "T1-s001.h5").exists()


def alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


def test_hanging_worker_is_killed_with_its_children(bench: Bench) -> None:
    summary = bench.run(specs(1), {"T1-s000": "hang"}, trial_limit_s=4.0)
    assert summary.ended == {"T1-s000": "harness_error"}
    failure = bench.recording("T1-s000").header.failure
    assert failure is not None
    assert failure.kind == "timeout"
    pids = [int(line.split()[1]) for line in bench.log.read_text().splitlines()]
    assert len(pids) == 2
    assert not any(alive(pid) for pid in pids)


def test_a_policy_whose_trial_dies_with_it_twice_has_failed(bench: Bench) -> None:
    """A trial that the harness lost counts neither way, so a policy that kills its worker would have n shrink."""
    does = {"T1-s000": "lost", "T1-s001": "lost_once", "T1-s002": "lost_after"}
    summary = bench.run(specs(3), does)
    assert summary.ended == {
        "T1-s000": "process_failure",
        "T1-s001": "done",
        "T1-s002": "harness_error",
    }
    assert bench.ran() == [*["T1-s000"] * 2, *["T1-s001"] * 2, *["T1-s002"] * 2]
    redone = [event.trial_id for event in bench.events if event.kind == "redo"]
    assert sorted(redone) == ["T1-s000", "T1-s001", "T1-s002"]
    recording = bench.recording("T1-s000")
    failure = recording.header.failure
    assert failure is not None
    assert failure.kind == "killed"
    assert "died of signal 9 (Killed) while the policy was running, in both attempts" in failure.message
    score = score_recording(recording)
    assert (score.is_judged, score.failure_mode, score.attribution) == (True, "process_failure", "process")


def test_resume_runs_only_what_is_missing_damaged_or_asked_for(bench: Bench) -> None:
    does = {"T1-s001": "policy", "T1-s002": "exit"}
    bench.run(specs(3), does)
    first = (bench.out / "T1-s000.h5").read_bytes()

    again = bench.run(specs(3))
    assert bench.ran() == ["T1-s002"], "what the machine caused is no verdict"
    assert (again.ran, set(again.kept)) == (("T1-s002",), {"T1-s000", "T1-s001"})
    assert again.ended == {"T1-s000": "done", "T1-s001": "process_failure", "T1-s002": "done"}

    damaged = bytearray(first)
    damaged[len(damaged) // 2 :] = b""
    (bench.out / "T1-s000.h5").write_bytes(damaged)
    bench.run(specs(4))
    assert bench.ran() == ["T1-s000", "T1-s003"]
    assert [e.trial_id for e in bench.events if e.kind == "redo" and "T1-s000.h5" in (e.message or "")] == ["T1-s000"]
    assert (bench.out / "T1-s000.h5").read_bytes() == first

    bench.run(specs(4), retry_failed=True)
    assert bench.ran() == ["T1-s001"]
    assert not list(bench.out.glob("*.log"))
    assert bench.recording("T1-s002").header.ended == "done"


def test_a_run_with_sensor_noise_draws_a_salt_of_its_own_and_keeps_it(bench: Bench, tmp_path: Path) -> None:
    noise = PROTOCOL.variation.model_copy(update={"depth_noise": "structured-light-v1"})
    noisy = PROTOCOL.model_copy(update={"variation": noise})
    trials = [spec.model_copy(update={"protocol": noisy}) for spec in specs(2)]
    bench.run(trials[:1])
    bench.run(trials)
    assert bench.ran() == ["T1-s001"]
    first, second = (bench.recording(f"T1-s00{k}").header.spec.noise_salt for k in range(2))
    assert len(first) == 32
    assert first == second == json.loads((bench.out / "manifest.json").read_text())["noise_salt"]

    another = Bench(tmp_path / "another")
    another.folder.mkdir()
    another.run(trials[:1])
    assert another.recording("T1-s000").header.spec.noise_salt != first
    quiet = Bench(tmp_path / "quiet")
    quiet.folder.mkdir()
    quiet.run(specs(1))
    assert quiet.recording("T1-s000").header.spec.noise_salt == ""


def test_misnamed_recording_is_run_again(bench: Bench) -> None:
    bench.run(specs(1))
    (bench.out / "T1-s001.h5").write_bytes((bench.out / "T1-s000.h5").read_bytes())
    bench.run(specs(2))
    assert bench.ran() == ["T1-s001"]
    assert bench.recording("T1-s001").header.spec.seed == 1


def test_folder_of_another_run_is_refused_and_untouched(bench: Bench) -> None:
    bench.run(specs(1))
    changed = PROTOCOL.model_copy(update={"description": "another"})
    for foreign in (specs(2, policy="zero-action"), [specs(1)[0].model_copy(update={"protocol": changed})]) * 2:
        before = {path.name: path.read_bytes() for path in bench.out.iterdir()}
        with pytest.raises(ConfigError, match=r"holds another run.*use another folder"):
            bench.run(foreign)
        assert {path.name: path.read_bytes() for path in bench.out.iterdir()} == before
        if foreign[0].policy == "hover":  # Then also without a manifest.
            (bench.out / "manifest.json").unlink(missing_ok=True)


def test_manifest_names_the_run_and_does_not_depend_on_order(bench: Bench) -> None:
    bench.run(specs(1))
    bench.run(specs(3)[::-1])
    manifest = (bench.out / "manifest.json").read_text()
    held = json.loads(manifest)
    identity = held.pop("identity")
    assert identity["policy_sha256"] is None
    assert identity["versions"] == {"carecontact": __version__, "mujoco": metadata.version("mujoco")}
    assert {what: len(digest) for what, digest in identity["sha256"].items()} == {"body": 64, "robot": 64}
    assert identity["world"] == DECLARED
    assert held == {
        "schema": "carecontact-run-1",
        "purpose": "run",
        "policy": "hover",
        "protocol": {"id": PROTOCOL.id, "sha256": PROTOCOL.sha256, "overrides": {}},
        "trials": ["T1-s000", "T1-s001", "T1-s002"],
    }
    bench.run(specs(2))
    assert (bench.out / "manifest.json").read_text() == manifest


def test_a_manifest_of_other_packages_or_assets_or_a_damaged_one_is_refused_and_kept(bench: Bench) -> None:
    bench.run(specs(1))
    path = bench.out / "manifest.json"
    held, wrong = json.loads(path.read_text()), dict[str, str]()
    for group, name, value in (
        ("versions", "mujoco", "3.0"),
        ("versions", "carecontact", "0"),
        ("sha256", "body", "0"),
    ):
        changed = held["identity"] | {group: held["identity"][group] | {name: value}}
        wrong[json.dumps(held | {"identity": changed})] = rf"{name}.* was {value[:3]}.*use another folder"
    wrong |= dict.fromkeys(("{", "[]", '{"schema": "carecontact-run-1", "trials": []}'), r"manifest\.json is damaged")
    for content, message in wrong.items():
        path.write_text(content)
        with pytest.raises(ConfigError, match=message):
            bench.run(specs(2))
        assert path.read_text() == content
    assert bench.ran() == []


def test_edited_policy_gets_no_more_trials_in_the_same_folder(bench: Bench) -> None:
    source = bench.folder / "mine" / "own.py"
    source.parent.mkdir()
    source.write_text("class Own: ...\n")
    own = PolicySetup.of("mine.own:Own", search_path=[str(bench.folder)])
    bench.run(specs(1, policy="mine.own:Own"), policy=own)
    assert bench.run(specs(2, policy="mine.own:Own"), policy=own).ran == ("T1-s001",)
    source.write_text("class Own: 'better'\n")
    message = r"policy's source changed .* none of its 2 trials, 0 of them failed, .* another folder, .* --restart"
    with pytest.raises(ConfigError, match=message):
        bench.run(specs(3, policy="mine.own:Own"), policy=own)
    (bench.out / "manifest.json").unlink()
    with pytest.raises(ConfigError, match=r"no manifest\.json"):
        bench.run(specs(3, policy="mine.own:Own"), policy=own)
    assert not (bench.out / "T1-s002.h5").exists()


def test_wrong_requests_are_refused_before_anything_is_written(bench: Bench) -> None:
    both = [*specs(1), *specs(2, policy="zero-action")[1:]]
    for trials, options, message in [
        (specs(1), {"jobs": 0}, "jobs 0"),
        ([], {}, "no trial"),
        (both, {}, "one policy"),
        (specs(1) * 2, {}, "planned twice"),
    ]:
        with pytest.raises(ConfigError, match=message):
            bench.run(trials, **options)
    assert not bench.out.exists()
    bench.out.write_text("a file")
    with pytest.raises(ConfigError, match="this is a file"):
        bench.run(specs(1))


def test_interrupt_kills_the_workers_and_keeps_what_is_finished(bench: Bench) -> None:
    program = (
        "import sys; sys.path.insert(0, sys.argv[1])\n"
        "from pathlib import Path\n"
        "from test_supervisor import Bench, specs\n"
        "Bench(Path(sys.argv[2])).run(specs(2), {'T1-s001': 'hang'}, jobs=1)\n"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", program, str(Path(__file__).parent), str(bench.folder)],
        stderr=subprocess.DEVNULL,
        # A shell's background job ignores Ctrl-C and hands that on: tests started so would wait for ever.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )
    deadline = time.monotonic() + 60
    while "child" not in bench.ran() and time.monotonic() < deadline:
        time.sleep(0.05)
    os.kill(process.pid, signal.SIGINT)
    assert process.wait(timeout=30) != 0
    pids = [int(line.split()[1]) for line in bench.log.read_text().splitlines()]
    assert len(pids) == 3
    assert not any(alive(pid) for pid in pids)
    assert {path.name for path in bench.out.iterdir()} == {"T1-s000.h5", "manifest.json"}
    assert bench.recording("T1-s000").header.ended == "done"


def test_a_folder_that_vanishes_is_named(bench: Bench) -> None:
    class Vanishing(list[TrialEvent]):
        def append(self, event: TrialEvent) -> None:
            if event.kind == "finished":
                shutil.rmtree(bench.out)

    bench.events = Vanishing()
    with pytest.raises(StorageError, match=rf"^{bench.out}: somebody removed or moved this folder while its trials"):
        bench.run(specs(3), jobs=1)


def test_a_status_arrives_in_any_pieces() -> None:
    read, write = os.pipe()
    status = StatusPipe(read)
    status.read()
    assert (status.policy_runs, status.answers) == (False, b"")
    digests = [bytes([k]) * 32 for k in (1, 2)]
    for piece in (b'{"policy_runs": true}\n{"ans', b'wer": "', digests[0].hex().encode(), b'"}\n'):
        os.write(write, piece)
        status.read()
        assert status.policy_runs
    os.write(write, f'{{"answer": "{digests[1].hex()}"}}\n{{"unreached": "nobody"}}\n'.encode())
    status.read()
    assert status.answers == b"".join(digests)
    os.write(write, b'{"policy_runs": false}\n')
    status.read()
    assert not status.policy_runs
    assert status.said["unreached"] == "nobody"
    os.close(write)
    status.read()
    status.close()


def test_more_answers_than_a_pipe_holds() -> None:
    read, write = os.pipe()
    status, count = StatusPipe(read), 5000

    def answer() -> None:
        for k in range(count):
            os.write(write, f'{{"answer": "{k.to_bytes(32).hex()}"}}\n'.encode())
        os.close(write)

    thread = threading.Thread(target=answer)
    thread.start()
    while thread.is_alive():
        status.read()
    status.read()
    status.close()
    assert len(status.answers) == count * 32

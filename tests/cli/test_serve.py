"""run against a served policy, and what serve refuses; workers only write recordings."""

from __future__ import annotations

import json
import os
import resource
import shlex
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from types import SimpleNamespace

import pytest

from carecontact.cli import main
from carecontact.cli.groups import PolicyGroup
from carecontact.cli.policy import CREDENTIALS, policy_setup
from carecontact.errors import ConfigError
from carecontact.interface.policy import API_KEY
from carecontact.recording import read_recording
from carecontact.running.engine import TrialRequest
from tests.serving.conftest import PREAMBLE
from tests.serving.served import WITHOUT_WAITING, served

RUN = ["run", "--tasks", "T1", "--seeds", "0", "--out", "r", "--policy"]


def test_a_run_names_the_address_without_its_credentials(
    fake: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    environment = dict(os.environ)
    with served("class P(Base): pass", tmp_path) as (port, _):
        assert main([*RUN, f"ws://user:secret@127.0.0.1:{port}"]) == 0
    assert dict(os.environ) == environment, "a request changes no variable"
    (request,) = Path("requests.jsonl").read_text().splitlines()
    Path("requests.jsonl").unlink()
    assert TrialRequest.model_validate_json(request).policy.ref.credentials == "user:secret"
    address = f"ws://127.0.0.1:{port}"
    assert capsys.readouterr().out.startswith(f"{address}: 1 trial")
    assert read_recording(Path("r/T1-s000.h5")).header.spec.policy == address
    manifest = json.loads(Path("r/manifest.json").read_text())
    assert (manifest["policy"], manifest["identity"]["policy_sha256"]) == (address, None)
    for path in Path().rglob("*"):
        assert path.is_dir() or b"secret" not in path.read_bytes(), path


def test_credentials_may_come_from_a_variable(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(CREDENTIALS, "user:secret")
    assert policy_setup("ws://h:80", PolicyGroup()).ref.credentials == "user:secret"
    assert policy_setup("ws://me:mine@h:80", PolicyGroup()).ref.credentials == "me:mine"


def test_a_dialects_key_comes_from_its_own_variable(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(CREDENTIALS, "user:secret")
    assert policy_setup("openpi://h:80", PolicyGroup()).ref.credentials == ""
    monkeypatch.setenv(API_KEY, "sk-key")
    setup = policy_setup("openpi://h:80?profile=pi05-droid", PolicyGroup())
    assert setup.ref.credentials == "sk-key"
    assert "sk-key" not in repr(setup)
    monkeypatch.setenv(API_KEY, "sk-key\r\nX: y")
    with pytest.raises(ConfigError, match="CARECONTACT_API_KEY: expected one line of printable ASCII") as caught:
        policy_setup("openpi://h:80", PolicyGroup())
    assert "sk-key" not in str(caught.value)


def test_a_server_that_is_not_there_is_named_before_anything_runs(
    fake: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    fake.setattr("carecontact.serving.opening.FIRST_PAUSE_S", WITHOUT_WAITING)
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
    assert main([*RUN, f"ws://127.0.0.1:{port}"]) == 2
    printed = capsys.readouterr().err
    assert f"--policy ws://127.0.0.1:{port} does not answer as a policy server: " in printed
    assert "nothing listens at" in printed
    for option in (["--language", "rules-v1"], ["--policy-arg", "steps=3"], ["--policy-env", "HOME"]):
        assert main([*RUN, f"ws://127.0.0.1:{port}", *option]) == 2
        assert "give them to `carecontact serve` there" in capsys.readouterr().err
    assert not Path("r").exists()


def test_a_run_waits_for_a_server_that_starts_later(
    fake: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
    with ExitStack() as servers:

        def sleep(pause_s: float) -> None:
            servers.enter_context(served("class P(Base): pass", tmp_path, port=port))

        fake.setattr("carecontact.serving.opening.time", SimpleNamespace(sleep=sleep))
        assert main([*RUN, f"ws://127.0.0.1:{port}"]) == 0
    assert f"nothing listens at 127.0.0.1:{port}; start the policy's server there first; trying again for" in (
        capsys.readouterr().out
    )


def test_a_server_that_stays_away_ends_the_run_with_status_2_and_says_how_to_go_on(
    fake: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    fake.setenv("FAKE_PLAN", json.dumps({"T1-s001": "unreached", "T1-s000": "policy"}))
    with served("class P(Base): pass", tmp_path) as (port, _):
        run = ["run", "--tasks", "T1", "--seeds", "0-2", "--jobs", "1", "--policy", f"ws://127.0.0.1:{port}", "--out"]
        assert main([*run, "r", "--restart"]) == 2
        printed = capsys.readouterr()
        assert printed.err.splitlines() == [
            "error: the run stops with 1 of 3 trials done: nothing listens there; then continue with: "
            f"{shlex.join(['carecontact', *run, 'r'])}"
        ]
        assert "the policy crashed in 1 of 1 trial" in printed.out
        assert "incomplete, 1 of 3 planned trials have a verdict: 0–2/3 safety-gated" in printed.out
        assert "no verdict on 2 planned trials, no recording: T1-s001, T1-s002" in printed.out
        assert "passed 0 to 2 of 3 trials safely" in Path("r/report.html").read_text()
        fake.setenv("FAKE_PLAN", json.dumps({"T1-s000": "unreached"}))
        assert main([*run, "none"]) == 2
        assert "the run stops with 0 of 3 trials done: " in capsys.readouterr().err
        fake.setenv("FAKE_PLAN", "{}")
        assert main([*run, "r"]) == 3
    assert sorted(path.name for path in Path("r").glob("*.h5")) == ["T1-s000.h5", "T1-s001.h5", "T1-s002.h5"]


def test_a_client_that_says_nothing_takes_no_place(fake: pytest.MonkeyPatch, tmp_path: Path) -> None:
    fake.setattr("carecontact.serving.opening.FIRST_PAUSE_S", WITHOUT_WAITING)
    with (
        served("class P(Base): pass", tmp_path, at_once=1) as (port, _),
        socket.create_connection(("127.0.0.1", port)),
    ):
        assert main([*RUN, f"ws://127.0.0.1:{port}", "--set", "phases.first_call_deadline_s=8"]) == 0


@contextmanager
def a_server(tmp_path: Path, before: Callable[[], None] = lambda: None) -> Iterator[tuple[int, subprocess.Popen[str]]]:
    """A command that serves on a port. ``before`` runs in its process first."""
    (tmp_path / "mine.py").write_text(PREAMBLE + "class P(Base): pass")
    server = subprocess.Popen(
        [sys.executable, "-m", "carecontact", "serve", "mine:P", "--port", "0", "--at-once", "1"],
        cwd=tmp_path, stdout=subprocess.PIPE, text=True, preexec_fn=before,
    )  # fmt: skip
    assert server.stdout is not None
    try:
        yield int(server.stdout.readline().rsplit(" ", 1)[1]), server
    finally:
        server.kill()
        server.wait()
        server.stdout.close()


def test_a_server_whose_lines_no_one_reads_any_more_goes_on(fake: pytest.MonkeyPatch, tmp_path: Path) -> None:
    with a_server(tmp_path) as (port, server):
        assert server.stdout is not None
        server.stdout.close()
        for _ in range(2):  # Each asks the server for the policy's card.
            assert main([*RUN, f"ws://127.0.0.1:{port}"]) == 0
        assert server.poll() is None


@pytest.mark.skipif(sys.platform != "linux", reason="counts descriptors in /proc")
def test_a_server_without_descriptors_says_so_and_serves_later(fake: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def few() -> None:
        resource.setrlimit(resource.RLIMIT_NOFILE, (40, 40))

    with a_server(tmp_path, few) as (port, server):
        held = len(os.listdir(f"/proc/{server.pid}/fd"))
        with ExitStack() as open_:
            for _ in range(45):
                open_.enter_context(socket.create_connection(("127.0.0.1", port))).sendall(b"G")
            time.sleep(3.0)
        until = time.monotonic() + 20.0
        while len(os.listdir(f"/proc/{server.pid}/fd")) > held and time.monotonic() < until:
            time.sleep(0.1)
        assert len(os.listdir(f"/proc/{server.pid}/fd")) == held
        assert main([*RUN, f"ws://127.0.0.1:{port}"]) == 0
        assert server.stdout is not None
        server.kill()
        assert "no connection is accepted for 1 s: Too many open files" in server.stdout.read()


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["absent"], "no policy named 'absent'"),
        (["ws://host:80"], "ws://host:80: a policy with an address is served already"),
        (["hover", "--port", "70000"], "--port 70000: expected 0 to 65535"),
        (["hover", "--at-once", "0"], "--at-once 0: must be at least 1"),
        (["hover", "--host", "192.0.2.1"], "cannot listen on 192.0.2.1, port 8765: "),
        (["hover", "--language", "rules-v1"], "policy hover takes no --language"),
        (["hover", "--policy-arg", "steps=3"], "policy 'hover' failed at start: it has no argument 'steps'"),
        (["not_there:P"], "--policy not_there:P does not start"),
    ],
)
def test_what_cannot_be_served(options: list[str], says: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["serve", *options]) == 2
    assert says in capsys.readouterr().err

"""Real trials on a Ray cluster of two nodes that this machine emulates, one of which dies in mid-run."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import psutil
import pytest

from carecontact.cli import main
from carecontact.protocol.load import load_protocol
from carecontact.protocol.overrides import overridden
from carecontact.protocol.protocol import TrialSpec
from carecontact.recording import read_header, stored_sha256
from carecontact.running.supervisor import TrialEvent, run_trials
from carecontact.runs.plan import plan_trials
from tests.serving.conftest import PREAMBLE

pytestmark = pytest.mark.slow
pytest.importorskip("ray", reason="needs the extra cluster")

POLICY = """
class P(Base):
    def act(self, observation):
        return [Action(pose_tcp_in_base=observation.pose_tcp_in_base)] * 5
"""


@pytest.fixture
def cluster(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    import ray
    from ray.cluster_utils import Cluster

    made: Any = Cluster(initialize_head=True, head_node_args={"num_cpus": 0, "include_dashboard": False})
    monkeypatch.setenv("RAY_ADDRESS", made.address)
    try:
        yield made
    finally:
        ray.shutdown()
        made.shutdown()


def trials(policy: str, seeds: int) -> list[TrialSpec]:
    rules = overridden(load_protocol("bathing-v3"), {"phases.time_limit_s": 1})
    return plan_trials(protocol=rules, policy=policy, tasks=["T1"], seeds=range(seeds))


def runs_a_trial(node: Any, *, within_s: float) -> bool:
    """Whether a trial's process is there on the node before the time is over."""
    raylet, until = psutil.Process(node.all_processes["raylet"][0].process.pid), time.monotonic() + within_s
    while time.monotonic() < until:
        if any(is_trial(process) for process in raylet.children(recursive=True)):
            return True
        time.sleep(0.05)
    return False


def is_trial(process: psutil.Process) -> bool:
    """Whether it was forked by a fork server, or is a trial's program."""
    with suppress(psutil.Error):
        line, parent = process.cmdline(), process.parent()
        return "carecontact.running.worker" in line or (
            "carecontact.running.fork_server" in line and parent is not None and parent.cmdline() == line
        )
    return False


def hashes(folder: Path) -> dict[str, str]:
    return {path.stem: stored_sha256(path) for path in folder.glob("*.h5")}


def test_a_node_that_dies_costs_no_trial_and_changes_no_hash(cluster: Any, tmp_path: Path) -> None:
    nodes = [cluster.add_node(num_cpus=1) for _ in range(2)]
    cluster.wait_for_nodes()
    events: list[TrialEvent] = []

    def watch(event: TrialEvent) -> None:
        events.append(event)
        if event.kind == "started" and len(nodes) == 2 and runs_a_trial(nodes[1], within_s=1.0):
            cluster.remove_node(nodes.pop(), allow_graceful=False)

    specs = trials("zero-action", 8)
    far = run_trials(specs, out=tmp_path / "far", engine="ray", on_event=watch)
    assert set(far.ended.values()) == {"time_limit"}
    assert len(far.ended) == 8
    lost = [event.message for event in events if event.kind == "redo"]
    assert lost, "the node died while it ran a trial"
    assert all("Ray lost it" in (message or "") for message in lost)
    run_trials(specs, out=tmp_path / "near")
    assert hashes(tmp_path / "far") == hashes(tmp_path / "near")
    assert read_header(tmp_path / "far/T1-s000.h5") == read_header(tmp_path / "near/T1-s000.h5")


def test_a_policy_in_a_file_goes_to_the_nodes(cluster: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cluster.add_node(num_cpus=2)
    cluster.wait_for_nodes()
    place = tmp_path / "place"
    place.mkdir()
    (place / "under_test.py").write_text(PREAMBLE + POLICY)
    (place / "runs").mkdir()
    monkeypatch.chdir(place)
    from carecontact.serving.conversation import PolicySetup

    setup = PolicySetup.of("under_test:P", search_path=(os.getcwd(),))
    specs = trials("under_test:P", 2)
    for engine in ("ray", "local"):
        found = run_trials(specs, out=place / "runs" / engine, policy=setup, engine=engine)
        assert found.ended == {"T1-s000": "time_limit", "T1-s001": "time_limit"}
    assert hashes(place / "runs/ray") == hashes(place / "runs/local")


PLAN = """
tasks = "T1"
seeds = "0"
policies = [{ policy = "zero-action" }, { policy = "under_test:P" }]
set = { "phases.time_limit_s" = 1 }
"""


def test_a_sweep_takes_a_policy_in_a_file_to_the_nodes_whichever_place_it_has(
    cluster: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    cluster.add_node(num_cpus=2)
    cluster.wait_for_nodes()
    (tmp_path / "under_test.py").write_text(PREAMBLE + POLICY)
    (tmp_path / "p.toml").write_text(PLAN)
    monkeypatch.chdir(tmp_path)
    assert main(["sweep", "p.toml", "--engine", "ray", "--out", "s"]) == 0, capsys.readouterr().out
    assert {read_header(path).ended for path in Path("s").rglob("*.h5")} == {"time_limit"}
    assert len(list(Path("s/cells").iterdir())) == 2

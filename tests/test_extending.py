"""An action, a region and a protocol that a stranger adds, each in a file of its own outside the package.

``tests/extending`` is what an installed package looks like: its metadata names the rows as entry points.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import carecontact
from carecontact.errors import ConfigError
from carecontact.human.skeleton import body_name
from carecontact.interface.regions import REGIONS
from carecontact.lab.validation.subject import move_to
from carecontact.protocol.gates import ACTIONS
from carecontact.protocol.load import load_protocol
from carecontact.protocol.overrides import overridden, without_overrides
from carecontact.protocol.protocol import Protocol, TrialSpec
from carecontact.recording import SEGMENTS, Recording, read_recording, write_recording
from carecontact.recording.provenance import trial_versions
from carecontact.report.run_page import write_report
from carecontact.running.engine import TrialRequest, setup_of
from carecontact.runs import score_run
from carecontact.scoring import METRICS, score_recording
from carecontact.scoring.behaviour import BEHAVIOURS
from carecontact.sim.simulation import Simulation
from carecontact.world.scene import Scene, build_scene
from tests.installed import look_again
from tests.scoring.synthetic import hold, make_recording

FOLDER = Path(__file__).parent / "extending"
FILE = FOLDER / "holding-v1.toml"
HAND = "right_hand"


@pytest.fixture(scope="module")
def outside() -> Iterator[None]:
    """The package ``outside`` is installed, and gone again afterwards."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(FOLDER)
        look_again(patch, ACTIONS, BEHAVIOURS, REGIONS, METRICS)
        yield


@pytest.fixture(scope="module")
def protocol(outside: None) -> Protocol:
    return load_protocol(str(FILE))


@pytest.fixture(scope="module")
def scene(protocol: Protocol) -> Scene:
    return build_scene(protocol, target=HAND, skin=False)


def held(protocol: Protocol, force: float, *, seconds: float = 3.0, seed: int = 0, **options: Any) -> Recording:
    """A hand that is pressed with a steady force from 0.5 s on."""
    normal = {HAND: hold(seconds + 1.0, 0.5, 0.5 + seconds, force)}
    return make_recording("T8", protocol=protocol, duration=seconds + 1.0, normal=normal, seed=seed, **options)


def test_the_protocol_has_ten_lines_and_everything_else_from_its_base(protocol: Protocol) -> None:
    assert len(FILE.read_text().splitlines()) == 10
    base = load_protocol("bathing-v3")
    assert (protocol.physics, protocol.person, protocol.limits) == (base.physics, base.person, base.limits)
    assert [(task.action, task.region) for task in protocol.tasks] == [("hold", HAND)]
    assert protocol.contact.neighbourhood[HAND] == list(REGIONS[HAND].neighbourhood), "the region's own default"
    assert not protocol.frozen
    assert Protocol.model_validate_json(protocol.model_dump_json()) == protocol
    assert protocol.regions == ("forearm", "upper_arm", "abdomen", HAND)
    assert HAND not in protocol.person.tissue


def test_the_page_shows_these_files() -> None:
    page = (Path(__file__).parents[1] / "docs" / "evidence" / "extending.md").read_text()
    for name in ("outside_hold.py", "outside_right_hand.py", "holding-v1.toml"):
        assert (FOLDER / name).read_text().rstrip() in page, name


def test_its_fields_can_be_replaced_and_a_wrong_one_is_named(protocol: Protocol, tmp_path: Path) -> None:
    other = overridden(protocol, {"gates.hold.high_n": "8"})
    assert other.title == "holding-v1 with gates.hold.high_n 8"
    assert without_overrides(other, protocol) == protocol
    wrong = tmp_path / "wrong.toml"
    wrong.write_text(FILE.read_text().replace("duration_s = 2.0", "seconds = 2.0"))
    with pytest.raises(ConfigError, match=r"wrong\.toml: 2 fields wrong(?s:.*)gates\.hold\.duration_s: missing"):
        load_protocol(str(wrong))
    wrong.write_text(FILE.read_text().replace("gates.hold", "gates.keep"))
    with pytest.raises(ConfigError, match=r"gates\.keep: no action named 'keep'; valid: .*hold"):
        load_protocol(str(wrong))


def test_the_world_has_the_region_as_target_without_a_shell(scene: Scene, protocol: Protocol) -> None:
    model = scene.model
    site = model.site(f"region_{HAND}")
    assert model.body(site.bodyid[0]).name == body_name(HAND)
    assert scene.region_size_m.shape == (4, 3)
    length, half_width, outward = scene.frames[HAND].size_m
    assert 0.15 < length < 0.25
    assert 0.01 < outward <= half_width * 1.5 < 0.12
    assert list(scene.regions) == ["forearm", "upper_arm", "abdomen"]
    # What is soft is as fine as where another region is the target.
    own = load_protocol("bathing-v3")
    assert all(region.tissue == own.person.tissue[name] for name, region in scene.regions.items())


def test_a_press_on_the_hand_is_felt_there_and_indents_nothing(scene: Scene) -> None:
    simulation = Simulation(scene)
    simulation.settle(52.5)
    simulation.start()
    middle = simulation.data.site(f"region_{HAND}").xpos.copy()
    move_to(simulation, middle + [0, 0, 0.10], seconds=3.0)
    samples = move_to(simulation, middle - [0, 0, 0.02], seconds=1.0)
    force = np.linalg.norm(np.concatenate([s.force for s in samples]), axis=2).max(0)
    assert SEGMENTS[force.argmax()] == HAND
    assert force.max() > 5.0
    assert samples[-1].region_pose.shape[1:] == (4, 7)
    np.testing.assert_array_equal(simulation.indentation()[3:], [0.0])


@pytest.mark.parametrize(
    ("force", "seconds", "success", "mode"),
    [
        (4.0, 3.0, True, None),
        (4.0, 1.5, False, "lost_contact"),
        (12.0, 3.0, False, "insufficient_progress"),
        (0.0, 3.0, False, "no_target_contact"),
    ],
)
def test_trials_are_judged(protocol: Protocol, force: float, seconds: float, success: bool, mode: str | None) -> None:
    score = score_recording(held(protocol, force, seconds=seconds))
    assert (score.action, score.region, score.c3_success, score.failure_mode) == ("hold", HAND, success, mode)
    assert score.safety_gated is success
    assert (score.indentation_m, score.extrapolated_share) == (0.0, None)
    if force:
        assert score.reported_segment == HAND
        assert score.c1_peak_force_n == pytest.approx(force)


def test_its_gate_is_swept_and_its_words_explain_a_failure(protocol: Protocol) -> None:
    assert score_recording(held(protocol, 7.0)).gate_sweep == {
        "floor_n": {"0.25": 0, "0.5": 0, "1": 0, "2": 0},
        "hold_high_n": {"4": 0, "6": 0, "8": 3},
    }
    surface = (0.0, 0.0, 0.0)
    long, short = [(0.4, surface)], [(0.4, surface), (1.0, (0.0, 0.0, 0.2))]
    right, planned = (score_recording(held(protocol, 7.0, targets_in_region=t)) for t in (long, short))
    assert (right.attribution, planned.attribution) == ("execution", "planning")
    assert right.evidence is not None
    assert "between 2 and 6 N was 0.00 s of 2 s" in right.evidence
    assert "right hand" in right.evidence


def test_it_stands_in_the_report(protocol: Protocol, tmp_path: Path) -> None:
    for seed, force in enumerate((4.0, 12.0)):
        recording = held(protocol, force, seed=seed, targets_in_region=[(0.4, (0.0, 0.0, 0.0))])
        write_recording(recording, tmp_path / f"{recording.header.spec.trial_id}.h5")
    run = score_run(tmp_path)
    assert run.skipped == {}
    assert [score.c3_success for score in run.scores] == [True, False]
    path = write_report(
        tmp_path,
        scores=run.scores,
        recordings=lambda trial: read_recording(tmp_path / f"{trial}.h5"),
        skipped=run.skipped,
    )
    page = path.read_text(encoding="utf-8")
    for words in ("Hold right hand", "Hold: largest force", "between 2 and 6 N", "holding-v1"):
        assert words in page, words


def test_recordings_name_the_package_that_supplied_the_rows(protocol: Protocol) -> None:
    assert trial_versions(protocol)["outside"] == version("outside") == "1.0"
    assert "outside" not in trial_versions(load_protocol("bathing-v3"))


def test_a_worker_process_finds_the_rows_by_itself(protocol: Protocol, tmp_path: Path) -> None:
    """It reads the spec, and the entry points of the installed package do the rest. Without the package, the error
    names what is missing."""
    gone = overridden(protocol, {"person.body": "smplx:gone.npz?sex=F"})
    spec = TrialSpec(protocol=gone, task_id="T8", seed=0, policy="zero-action")
    asked = TrialRequest(spec=spec, policy=setup_of(spec), out=tmp_path / "trial.h5").model_dump_json()
    source = Path(carecontact.__file__).parents[1]

    def worker(*path: Path) -> subprocess.CompletedProcess[str]:
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, path))}
        command = [sys.executable, "-P", "-m", "carecontact.running.worker"]
        return subprocess.run(command, input=asked, env=environment, capture_output=True, text=True, check=False)

    done = worker(source, FOLDER)
    assert done.returncode == 0, done.stderr
    header = read_recording(tmp_path / "trial.h5").header
    assert header.failure is not None
    assert "gone.npz" in header.failure.message, "it came as far as the body, which is not there"
    assert header.regions[-1] == HAND
    assert header.versions["outside"] == "1.0"
    assert "no action named 'hold'" in worker(source).stderr


# A stranger's action, region, metric, policy with an argument, and protocol, all in one real run.


def carecontact_outside(*command: str) -> subprocess.CompletedProcess[str]:
    paths = (str(Path(carecontact.__file__).parents[1]), str(FOLDER))
    return subprocess.run(
        [sys.executable, "-P", "-m", "carecontact", *command],
        cwd=FOLDER,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(paths)},
        capture_output=True,
        text=True,
    )


@pytest.mark.slow
def test_they_run_are_scored_and_stand_in_the_report(tmp_path: Path) -> None:
    done = carecontact_outside(
        "run", "--policy", "outside_press:Press", "--policy-arg", "press_mm=0", "--protocol", "holding-v1.toml",
        "--seeds", "0", "--out", str(tmp_path),
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    results = json.loads((tmp_path / "results.json").read_text())
    (trial,) = results["trials"]
    assert (trial["action"], trial["region"], trial["ended"]) == ("hold", "right_hand", "done")
    assert trial["c3_success"], trial["evidence"]
    assert trial["reported_segment"] == "right_hand"
    assert trial["policy_arguments"] == {"press_mm": "0"}
    assert 2.0 < trial["additional"]["mean_force@1"] < trial["c1_peak_force_n"]
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    for words in ("Hold right hand", "holding-v1", "Mean force of the touch", "outside_press:Press press_mm=0"):
        assert words in page, words


def test_an_action_space_and_a_control_run_and_stand_in_the_recording(tmp_path: Path) -> None:
    done = carecontact_outside(
        "run", "--policy", "outside_step:Step", "--tasks", "T1", "--seeds", "0", "--out", str(tmp_path)
    )
    assert done.returncode == 0, done.stdout + done.stderr
    (file,) = tmp_path.glob("*.h5")
    recording = read_recording(file)
    assert recording.header.control == "soft-joints"
    steps = recording["actions/joint"]
    np.testing.assert_array_equal(steps[:9], np.tile([0, 0, 0, 0, 0, 0, 0.02], (9, 1)))
    # The hand turned about its axis, so the tool stayed where it was.
    pose = recording["scorer/pose_tcp_in_world"]
    assert np.abs(pose[-1, 3:] - pose[0, 3:]).max() > 0.02
    assert np.abs(pose[-1, :3] - pose[0, :3]).max() < 0.01

"""Mistakes of a new user: each is answered in one line that says what to do, without a traceback."""

from __future__ import annotations

import socket
from pathlib import Path
from typing import Any

import pytest

from carecontact.cli import main
from carecontact.cli.groups import PhysicsGroup, RulesGroup
from carecontact.cli.parsing import COMMANDS, parse
from carecontact.cli.run import Run
from carecontact.errors import ActionError, ConfigError, PolicyError
from carecontact.interface.action import ACTION_SPACES
from carecontact.interface.regions import REGIONS
from carecontact.protocol.gates import ACTIONS
from carecontact.protocol.load import load_protocol
from carecontact.protocol.overrides import overridden
from carecontact.recording import Recording, write_recording
from carecontact.scoring.behaviour import BEHAVIOURS
from carecontact.serving.conversation import PolicySetup
from carecontact.serving.process import PolicyProcess
from tests.installed import look_again
from tests.policies.synthetic import SESSION, synthetic_observation
from tests.scoring.synthetic import hold, make_recording
from tests.serving.served import WITHOUT_WAITING

POLICY = """
import tensorfloe
class Helper: ...
class MyPolicy:
    def act(self, observation): ...
"""
HEIR = 'base = "bathing-v3"\nid = "mine-v1"\ndescription = "mine"\n'
RUN = ["run", "--out", "r", "--tasks", "T1", "--seeds", "0", "--policy"]
MISTAKES = {
    "a misspelt option": (
        [*RUN, "hover", "--jbos", "2"],
        "run has no option --jbos (did you mean '--jobs'?); `carecontact run --help` shows all options",
    ),
    "an option of another command": ([*RUN, "hover", "--quick"], "run has no option --quick; `carecontact run --help`"),
    "a misspelt command": (["rnu"], "carecontact has no command 'rnu' (did you mean 'run'?); valid: check, run, "),
    "a policy in place of a command": (["my_policy"], "carecontact has no command 'my_policy'; valid: check, run, "),
    "no policy": (["run", "--out", "r"], "run: name a policy with --policy (`carecontact list policies`), or give"),
    "a word for a number": ([*RUN, "hover", "--jobs", "two"], "--jobs: expected INT, got 'two'"),
    "a task in lower case, and --task for --tasks": (
        ["run", "--policy", "hover", "--out", "r", "--task", "t1"],
        "tasks: 't1' is not a task of bathing-wide-v2 L2 (did you mean 'T1'?); valid: T1, ",
    ),
    "a misspelt policy": ([*RUN, "state_machine"], "no policy named 'state_machine' (did you mean 'state-machine'?)"),
    "the file in place of the policy": ([*RUN, "my_policy.py"], "(did you mean my_policy:MyPolicy?)"),
    "a policy without its class": ([*RUN, "my_policy"], "(did you mean my_policy:MyPolicy?)"),
    "a misspelt module": ([*RUN, "my_polciy:MyPolicy"], "(did you mean my_policy:MyPolicy?)"),
    "a package that is not installed": ([*RUN, "my_policy:MyPolicy"], "No module named 'tensorfloe'"),
    "no server": ([*RUN, "ws://127.0.0.1:{port}"], "nothing listens at 127.0.0.1:{port}; start the policy's server"),
    "a field that a protocol does not have": (
        [*RUN, "hover", "--set", "physics.dt=0.004"],
        "no field 'dt' in physics (did you mean 'dt_s'?); valid: dt_s, ",
    ),
    "a protocol whose base is gone": ([*RUN, "hover", "--protocol", "gone.toml"], "gone.toml: base: protocol file no"),
    "a tissue set that there is not": (
        [*RUN, "hover", "--protocol", "tissue.toml"],
        "tissue.toml: person.tissue_set: no tissue set named 'manikin' (did you mean 'manikin-like'?); valid: ",
    ),
    "a field that a file misspells": (
        [*RUN, "hover", "--protocol", "field.toml"],
        "field.toml: phsyics: no such field in the file (did you mean 'physics'?); valid: base, id, ",
    ),
    "a misspelt base": (
        ["protocol", "show", "bsae.toml"],
        "bsae.toml: bsae: no such field in the file (did you mean 'base'?); valid: base, id, ",
    ),
    "a protocol without its base": (
        ["protocol", "show", "alone.toml"],
        'alone.toml: add base = "bathing-wide-v2" (valid: bathing-wide-v2, bathing-droid-v1, '
        "bathing-v3, FILE.toml), or give all fields; 12 ",
    ),
    "a protocol file without its ending": (
        ["protocol", "verify", "alone"],
        "no protocol named 'alone' (did you mean alone.toml?)",
    ),
    "a body that there is not": (
        [*RUN, "hover", "--body", "woman"],
        "error: --body: no body named 'woman'; valid: man-adult, ",
    ),
    "a body that there is not, of another command": (["verify", "physics", "--body", "woman"], "no body named 'woman'"),
    "a misspelt word of protocol": (
        ["protocol", "sho"],
        "error: carecontact protocol has no command 'sho' (did you mean 'show'?); "
        "valid: list, show, verify, lock, feasible, salt",
    ),
    "a misspelt word of list": (
        ["list", "policy"],
        "no choice named 'policy' (did you mean 'policies'?); valid: tasks",
    ),
    "a misspelt value": (
        [*RUN, "hover", "--segmenter", "mediapip"],
        "--segmenter: no choice named 'mediapip' (did you mean 'mediapipe'?); valid: ",
    ),
    "a policy without --policy": (
        ["run", "my_policy:MyPolicy"],
        "error: no option takes my_policy:MyPolicy (did you mean --policy my_policy:MyPolicy?); For full",
    ),
    "a policy and its folder without options": (
        ["run", "hover", "r"],
        "no option takes hover r (did you mean --policy hover --out r?); For full helptext",
    ),
    "a word too many": (["verify", "metrics", "forearm"], "error: no option takes forearm; For full helptext"),
    "--policy where it is no option": (
        ["check", "--policy", "hover"],
        "check has no option --policy; give the policy without --policy; `carecontact check --help`",
    ),
    "an option that is not close to any": (["view", "--start", "--tissue", "soft"], "no option --tissue; `carec"),
    "a dot in place of the colon": (
        ["check", "my_policy.MyPolicy"],
        "no policy named 'my_policy.MyPolicy'; valid: feint-and-wait, hover, ",
    ),
    "a dot in place of the colon, with what was meant": (
        ["check", "my_policy.MyPolicy"],
        "(did you mean my_policy:MyPolicy?)",
    ),
    "a folder that is not a run": (["report", "."], "holds no recordings (*.h5); name the --out of a run"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_one_line_that_says_what_to_do(
    mistake: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("carecontact.serving.opening.FIRST_PAUSE_S", WITHOUT_WAITING)
    Path("my_policy.py").write_text(POLICY)
    Path("gone.toml").write_text(HEIR.replace("bathing-v3", "no.toml"))
    Path("field.toml").write_text(HEIR + "phsyics.dt_s = 0.004\n")
    Path("bsae.toml").write_text(HEIR.replace("base", "bsae"))
    Path("alone.toml").write_text(HEIR.partition("\n")[2])
    Path("tissue.toml").write_text(HEIR + '[person]\ntissue_set = "manikin"\n')
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
    arguments, message = MISTAKES[mistake]
    assert main([argument.replace("{port}", str(port)) for argument in arguments]) == 2
    printed = capsys.readouterr()
    line, *traceback = printed.err.splitlines()
    assert message.replace("{port}", str(port)) in line
    assert line.startswith("error: ")
    assert "Traceback" not in line + printed.out
    assert bool(traceback) == (mistake == "a package that is not installed"), "only where a line of the policy is wrong"
    assert not Path("r").exists()


POSE = "[0.4, 0, 0.3, 0, 1, 0, 0]"
SERVED = """
import numpy as np
from carecontact.interface.action import Action
from carecontact.interface.policy import PolicyCard
class MyPolicy:
    card = {card}
    def reset(self, instruction): ...
    def act(self, observation):
        return {answer}
"""
CARD = 'PolicyCard(name="mine", cameras=())'
ANSWERS = {
    "a bare pose": (
        POSE,
        "; return Action(pose_tcp_in_base=[x, y, z, qw, qx, qy, qz]), or Action(joint=...) for joints, in",
    ),
    "a list of lists": (
        f"[{POSE}, {POSE}]",
        "; return [Action(pose_tcp_in_base=row) for row in rows], or with joint",
    ),
    "a dict": (f"dict(pose_tcp_in_base=np.array({POSE}))", "; return Action(pose_tcp_in_base="),
    "roll pitch yaw": (
        "Action(pose_tcp_in_base=[0.4, 0, 0.3, 0, 1, 0])",
        "got shape (6,) float64; six numbers look like x y z and roll pitch yaw: turn the angles into a quaternion w x",
    ),
    "a gripper of -1": (
        "Action(gripper=-1)",
        "got -1.0; 1 is open and 0 is closed: of a range from -1 to 1 send (1 + g)",
    ),
    "millimetres": (
        "Action(pose_tcp_in_base=[400, 0, 300, 0, 1, 0, 0])",
        "actions[0].pose_tcp_in_base: the position [400.0, 0.0, 300.0] looks like millimetres: send metres; ",
    ),
    "a difference": (
        "Action(pose_tcp_in_base=[0.01, 0, 0.005, 0, 0, 0, 0])",
        "looks like a difference to the tool's pose: send the absolute pose of the tool in base",
    ),
}


def answered(card: str, answer: str, folder: Path) -> str:
    (folder / "my_policy.py").write_text(SERVED.format(card=card, answer=answer))
    setup = PolicySetup.of("my_policy:MyPolicy", search_path=[str(folder)])
    with PolicyProcess(setup, first_deadline_s=60, deadline_s=60) as policy:
        try:
            space = ACTION_SPACES[policy.start().action_space]
            policy.reset("touch", SESSION)
            (action,) = policy.act(synthetic_observation()).actions
            try:
                space.check(action, SESSION)
            except ActionError as error:  # as ``Episode.step`` refuses it
                policy.refuse(0, error)
        except PolicyError as error:
            return str(error)
    raise AssertionError("the policy did not fail")


@pytest.mark.parametrize("mistake", ANSWERS)
def test_a_mistake_of_an_answer_is_one_line_that_says_what_to_do(mistake: str, tmp_path: Path) -> None:
    answer, message = ANSWERS[mistake]
    printed = answered(CARD, answer, tmp_path)
    assert message in printed
    assert "\n" not in printed


def test_a_card_as_a_dict_is_one_line_that_says_what_to_do(tmp_path: Path) -> None:
    printed = answered('{"name": "mine"}', "Action()", tmp_path)
    assert printed.endswith("got dict {'name': 'mine'}; write card = PolicyCard(name='mine') in place of the dict")


@pytest.mark.parametrize("command", COMMANDS)
def test_help_reads_well(command: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setenv("COLUMNS", "100")
    with pytest.raises(SystemExit):
        main([*command.split(), "--help"])
    printed = capsys.readouterr().out
    assert f"usage: carecontact {command} " in printed
    assert not [bad for bad in ("{None}", "(default: )", "(default: None)", "--null") if bad in printed]


def test_synonyms_are_understood(capsys: pytest.CaptureFixture[str]) -> None:
    for given in (["--null", "b"], ["--null=b"], ["--baseline", "b"]):
        assert main(["compare", "nowhere", *given]) == 2
        assert "nowhere: no such folder" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        (
            "ModuleNotFoundError(\"No module named 'ai_edge_litert'\")",
            "`carecontact doctor` prints the command that installs it",
        ),
        pytest.param(
            "ImportError('libGLESv2.so.2: no such file')",
            "cannot be imported (libGLESv2.so.2: no such file); `carecontact doctor` prints",
            marks=pytest.mark.slow,
        ),
    ],
)
def test_a_missing_vision_model_stops_the_run_before_a_trial_counts(
    fault: str, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    lacking = tmp_path / "lacking"
    lacking.mkdir()
    (lacking / "ai_edge_litert.py").write_text(f"raise {fault}")
    monkeypatch.setenv("PYTHONPATH", str(lacking))
    monkeypatch.chdir(tmp_path)
    assert main([*RUN, "state-machine", "--jobs", "1"]) == 2
    printed = capsys.readouterr().err
    assert "the run stops with 0 of 1 trial done: the modalities landmarks and masks need ai-edge-litert" in printed
    assert message in printed
    assert not list(tmp_path.glob("r/*.h5"))


# A run of another package's action, where that package is not installed any more.

OUTSIDE = Path(__file__).parents[1] / "extending"


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """A run of ``tests/extending`` that was scored and reported while it was installed."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(OUTSIDE)
        look_again(patch, ACTIONS, BEHAVIOURS, REGIONS)
        protocol = load_protocol(str(OUTSIDE / "holding-v1.toml"))
        made = make_recording("T8", protocol=protocol, duration=4.0, normal={"right_hand": hold(4.0, 0.5, 3.5, 4.0)})
        header = made.header.model_copy(update={"versions": {**made.header.versions, "outside": "1.0"}})
        write_recording(Recording(header=header, arrays=made.arrays), tmp_path / "T8-s000.h5")
        assert main(["report", "--rescore", str(tmp_path)]) == 0
        assert main(["report", str(tmp_path)]) == 0
    return tmp_path


@pytest.mark.parametrize(("option", "status"), [([], 2), (["--rescore"], 1)])
def test_report_and_scores_stay_and_the_package_is_named(
    run: Path, option: list[str], status: int, capsys: pytest.CaptureFixture[str]
) -> None:
    before = [(run / name).read_bytes() for name in ("report.html", "results.json")]
    assert main(["report", str(run), *option]) == status
    printed = capsys.readouterr()
    for words in ("T8-s000.h5", "no action named 'hold'", "recorded with outside 1.0, not installed here"):
        assert words in (printed.out if option else printed.err)
    assert [(run / name).read_bytes() for name in ("report.html", "results.json")] == before


# ``--set FIELD=VALUE`` on the commands that choose a protocol, and the options that are short for it.

CHOOSE_RULES = {
    "run": ["--policy", "hover", "--out", "r"],
    "view": ["--start"],
    "verify physics": [],
    "verify metrics": [],
    "verify leaks": [],
    "calibrate": ["trials.csv"],
}
CHANGES = {"physics.dt_s": "0.004", "gates.push.force_n": "4"}


@pytest.mark.parametrize("command", CHOOSE_RULES)
def test_every_command_that_chooses_rules_takes_it_more_than_once(command: str) -> None:
    given = [part for path, value in CHANGES.items() for part in ("--set", f"{path}={value}")]
    parsed: Any = parse([*command.split(), *CHOOSE_RULES[command], *given])
    rules = parsed.sheet.rules if command == "view" else parsed.rules
    own = load_protocol("bathing-wide-v2")
    assert rules.load() == overridden(own, CHANGES)


def test_body_tissue_fast_and_stiffness_are_short_for_it() -> None:
    short = ["--body", "woman-old-light", "--tissue", "human-published", "--fast", "--stiffness", "200"]
    run = parse(["run", *CHOOSE_RULES["run"], *short])
    long = overridden(
        load_protocol("bathing-wide-v2"),
        {"person.body": "woman-old-light", "person.tissue_set": "human-published", "physics.dt_s": "0.004",
         "impedance.translational_n_m": "200"},
    )  # fmt: skip
    assert run._protocol() == long


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (("physics.dt_s",), r"--set physics\.dt_s: expected FIELD=VALUE"),
        (("=3",), r"--set =3: expected FIELD=VALUE"),
        (("physics.dt_s=0.004", "physics.dt_s=0.005"), r"--set: physics\.dt_s is replaced twice"),
        (("person.body=man-adult",), r"--body: another option replaces person\.body"),
        (("physics.dt_ms=4",), r"physics\.dt_ms: no field 'dt_ms' in physics .*; valid: dt_s, integrator"),
    ],
)
def test_what_is_wrong_is_named(given: tuple[str, ...], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        RulesGroup(changes=given, body="woman-old-light").load()


def test_an_option_and_a_set_of_one_field_contradict_each_other() -> None:
    rules = RulesGroup(changes=("physics.dt_s=0.005",))
    with pytest.raises(ConfigError, match=r"--fast: another option replaces physics\.dt_s"):
        rules.changed(load_protocol("bathing-v3"), **PhysicsGroup(fast=True).changes(load_protocol("bathing-v3")))


def test_a_run_says_what_was_set(fake: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    from carecontact.cli import main

    command = ["run", "--policy", "hover", "--tasks", "T1", "--seeds", "0", "--out", "r"]
    assert main([*command, "--set", "gates.touch.duration_s=2"]) == 0
    assert "bathing-wide-v2 L2 with gates.touch.duration_s 2" in capsys.readouterr().out
    assert main(command) == 2, "the folder holds trials of other rules"


def test_latency_is_an_option_of_run_in_milliseconds() -> None:
    run = parse(["run", "--policy", "hover", "--out", "r", "--latency-ms", "250"])
    assert isinstance(run, Run)
    assert run._protocol().phases.latency_s == 0.25
    assert run._protocol().title == "bathing-wide-v2 L2 with phases.latency_s 0.25"
    wrong = parse(["run", "--policy", "hover", "--out", "r", "--latency-ms", "250", "--set", "phases.latency_s=1"])
    assert isinstance(wrong, Run)
    with pytest.raises(ConfigError, match=r"--latency-ms: another option replaces phases\.latency_s"):
        wrong._protocol()

"""``--set FIELD=VALUE`` on the commands that choose a protocol, and the options that are short for it."""

from __future__ import annotations

import pytest

from carecontact.cli.commands import parse
from carecontact.cli.groups import PhysicsGroup, RulesGroup
from carecontact.cli.run import Run
from carecontact.errors import ConfigError
from carecontact.protocols import load_protocol, overridden
from tests.cli.test_run_and_demo import fake

__all__ = ["fake"]

COMMANDS = {
    "run": ["--policy", "hover", "--out", "r"],
    "look": ["--task", "T1"],
    "validate": [],
    "probe": [],
    "audit": [],
    "calibrate": ["trials.csv"],
}
CHANGES = {"physics.dt_s": "0.004", "gates.push.force_n": "4"}


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_that_chooses_rules_takes_it_more_than_once(command: str) -> None:
    given = [part for path, value in CHANGES.items() for part in ("--set", f"{path}={value}")]
    rules = parse([command, *COMMANDS[command], *given]).rules
    own = load_protocol()
    assert rules.load() == overridden(own, CHANGES)


def test_body_tissue_fast_and_stiffness_are_short_for_it() -> None:
    short = ["--body", "woman-old-light", "--tissue", "human-published", "--fast", "--stiffness", "200"]
    run = parse(["run", *COMMANDS["run"], *short])
    long = overridden(
        load_protocol(),
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
        rules.changed(load_protocol(), **PhysicsGroup(fast=True).changes(load_protocol()))


def test_a_run_says_what_was_set(fake: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    from carecontact.cli import main

    command = ["run", "--policy", "hover", "--tasks", "T1", "--seeds", "0", "--out", "r"]
    assert main([*command, "--set", "gates.touch.duration_s=1"]) == 0
    assert "bathing-v3-draft with gates.touch.duration_s 1" in capsys.readouterr().out
    assert main(command) == 2, "the folder holds trials of other rules"


def test_latency_is_an_option_of_run_in_milliseconds() -> None:
    run = parse(["run", "--policy", "hover", "--out", "r", "--latency-ms", "250"])
    assert isinstance(run, Run)
    assert run._protocol().phases.latency_s == 0.25
    assert run._protocol().title == "bathing-v3-draft with phases.latency_s 0.25"
    wrong = parse(["run", "--policy", "hover", "--out", "r", "--latency-ms", "250", "--set", "phases.latency_s=1"])
    assert isinstance(wrong, Run)
    with pytest.raises(ConfigError, match=r"--latency-ms: another option replaces phases\.latency_s"):
        wrong._protocol()

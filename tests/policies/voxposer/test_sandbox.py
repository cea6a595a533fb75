from __future__ import annotations

import time
from dataclasses import dataclass

import pytest
from pydantic_monty import ClassInstance

from carecontact.errors import LanguageError, ProgramError
from carecontact.policies.voxposer import sandbox as module
from carecontact.policies.voxposer.sandbox import ProgramTime, Sandbox


@dataclass
class Thing:
    shown: int = 1
    hidden: str = "secret"


THING = Thing()
TABLE = {"add": lambda a, b: a + b, "thing": lambda: ClassInstance(THING, eager_attrs=("shown",))}

HOSTILE = {
    "reads a file": ("open('/etc/passwd').read()", "PermissionError"),
    "reads a file by pathlib": ("from pathlib import Path\nPath('/etc/passwd').read_text()", "PermissionError"),
    "lists a folder": ("import os\nos.listdir('/')", "PermissionError"),
    "writes a file": ("open('/tmp/mine', 'w').write('x')", "PermissionError"),
    "reads the environment": ("import os\nos.environ['OPENAI_API_KEY']", "RuntimeError"),
    "imports a process": ("import subprocess", "ModuleNotFoundError"),
    "imports a socket": ("import socket", "ModuleNotFoundError"),
    "imports numpy": ("import numpy", "ModuleNotFoundError"),
    "imports the simulator": ("import mujoco", "ModuleNotFoundError"),
    "imports by hand": ("__import__('os')", "NameError"),
    "climbs the classes": ("().__class__.__bases__[0].__subclasses__()", "AttributeError"),
    "takes our globals": ("add.__globals__", "AttributeError"),
    "takes our object's insides": ("thing().hidden", "AttributeError"),
    "takes our object's dictionary": ("thing().__dict__", "AttributeError"),
    "takes attributes by name": ("getattr(thing(), 'hid' + 'den')", "AttributeError"),
    "evaluates its way there": ('eval("thing().hid" + "den")', "AttributeError"),
    "asks for 10 GB": ("x = [0] * (10 ** 10)", "MemoryError"),
    "asks for 10 GB of text": ("x = 'a' * (10 ** 10)", "MemoryError"),
    "asks for it bit by bit": ("x = []\nwhile True:\n    x.append('a' * 1000)", "MemoryError"),
    "computes a huge number": ("x = 10 ** 10 ** 9", "MemoryError"),
    "calls itself for ever": ("def f():\n    return f()\nf()", "RecursionError"),
    "prints for ever": ("while True:\n    print('a' * 1000)", "MemoryError|TimeoutError"),
    "calls us for ever": ("while True:\n    add(1, 2)", "RuntimeError: more than 2000 calls|TimeoutError"),
    "calls us wrongly": ("add(1)", r"TypeError: missing a required argument: 'b'; .* add\(a, b\) \(line 1: add"),
    "is no program": ("move the arm, please", "SyntaxError"),
    "fails": ("1 / 0", "ZeroDivisionError"),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_a_hostile_program_is_stopped_and_a_benign_one_runs_after_it(
    sandbox: Sandbox, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "LIMITS", {**module.LIMITS, "max_feed_duration_secs": 0.5})
    code, fault = HOSTILE[name]
    with pytest.raises(ProgramError, match=rf"^program p was stopped: ({fault})"):
        sandbox.value("p", f"{code}\nret_val = 1", TABLE)
    assert sandbox.value("q", "ret_val = add(1, 2)", TABLE) == 3
    assert THING == Thing()


def test_an_endless_loop_is_stopped(sandbox: Sandbox, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "LIMITS", {**module.LIMITS, "max_feed_duration_secs": 0.2})
    with pytest.raises(ProgramError, match="TimeoutError: time limit exceeded"):
        sandbox.value("p", "while True:\n    pass", {})
    with pytest.raises(ProgramError, match="TimeoutError"):
        sandbox.value("p", "try:\n    while True:\n        pass\nexcept BaseException:\n    pass\nret_val = 1", {})


def test_programs_inside_programs_share_their_time(sandbox: Sandbox, monkeypatch: pytest.MonkeyPatch) -> None:
    shared = ProgramTime(1)
    monkeypatch.setattr(sandbox, "time", shared)
    work = "x = 0\nfor k in range(20000):\n    x += k\nret_val = x"
    table = {"inner": lambda: sandbox.value("inner", work, {})}
    assert sandbox.value("outer", "ret_val = inner()", table) == sum(range(20000))
    left = shared.left_s
    assert 0 < left < 1
    endless = "try:\n    while True:\n        inner()\nexcept BaseException:\n    pass\nret_val = 1"
    with pytest.raises(ProgramError, match=r"program (inner|outer) was stopped: the programs of one step"):
        sandbox.value("outer", endless, table)
    with pytest.raises(ProgramError, match=r"program q was stopped: the programs of one step took more than 1 s"):
        sandbox.value("q", "ret_val = 1", {})
    shared.start_over()
    assert sandbox.value("q", "ret_val = 1", {}) == 1


def test_waiting_for_a_language_model_is_not_a_programs_time(sandbox: Sandbox, monkeypatch: pytest.MonkeyPatch) -> None:
    shared = ProgramTime(0.5)
    monkeypatch.setattr(sandbox, "time", shared)

    def ask() -> int:
        with shared.not_counted():
            time.sleep(0.3)
        return 1

    assert sandbox.value("p", "ret_val = ask() + ask()", {"ask": ask}) == 2
    assert shared.left_s > 0


def test_waiting_and_chance_are_none(sandbox: Sandbox) -> None:
    code = "import random, time\nfrom datetime import datetime\ntime.sleep(1000)\n"
    values = [sandbox.value("p", code + "ret_val = (random.random(), str(datetime.now()))", {}) for _ in range(2)]
    assert values[0] == values[1]


def test_handles_come_back_as_what_they_are(sandbox: Sandbox) -> None:
    assert sandbox.value("p", "t = thing()\nassert t.shown == 1\nret_val = t", TABLE) is THING


def test_nothing_of_a_program_is_left_for_the_next(sandbox: Sandbox) -> None:
    sandbox.value("p", "left = 1\nret_val = left", {})
    with pytest.raises(ProgramError, match="NameError: name 'left' is not defined"):
        sandbox.value("q", "ret_val = left", {})


def test_a_program_without_a_result(sandbox: Sandbox) -> None:
    with pytest.raises(ProgramError, match="NameError: name 'ret_val' is not defined"):
        sandbox.value("p", "x = 1", {})


def test_our_own_errors_pass_whatever_a_program_does(sandbox: Sandbox) -> None:
    asked = []

    def ask() -> None:
        asked.append(1)
        raise LanguageError("the endpoint sleeps")

    for code in ("ask()", "try:\n    ask()\nexcept Exception:\n    pass\nask()\nret_val = 1"):
        with pytest.raises(LanguageError, match=r"^the endpoint sleeps$"):
            sandbox.value("p", code, {"ask": ask})
    assert len(asked) == 2, "once a program is being stopped, nothing more is done for it"


def test_a_program_waits_at_a_call_while_others_run(sandbox: Sandbox) -> None:
    code = "a = 1\nexecute(a, speed=2)\nexecute(a + 1)\na = add(a, 1)"
    calls = sandbox.calls("p", code, TABLE | {"execute": lambda *a, **k: None}, pause_at=("execute",))
    first = next(calls)
    assert (first.args, first.kwargs) == ((1,), {"speed": 2})
    assert sandbox.value("q", "ret_val = 7", {}) == 7
    assert [call.args for call in calls] == [(2,)]


def test_a_program_may_be_stopped_after_it_waited(sandbox: Sandbox) -> None:
    calls = sandbox.calls("p", "go()\n1 / 0", {"go": lambda: None}, pause_at=("go",))
    next(calls)
    with pytest.raises(ProgramError, match=r"ZeroDivisionError.*\(line 2: 1 / 0\)"):
        next(calls)


def test_a_very_long_program_is_not_run(sandbox: Sandbox) -> None:
    with pytest.raises(ProgramError, match="at most 20000"):
        sandbox.value("p", "x = 1\n" * 5000, {})

"""From the text of --policy-arg to what a constructor or factory takes."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Literal, Optional

import pytest

from carecontact.errors import ContractError
from carecontact.policies.language.backend import LanguageBackend
from carecontact.serving import child, codec
from carecontact.serving.arguments import ArgumentError, bind, parameters_of
from carecontact.serving.child import ImportWall, raise_wall
from carecontact.serving.process_tree import readable_descriptors
from carecontact.serving.witness import RECEIVED_FILE, TASK, Witness
from tests.policies.synthetic import SESSION, synthetic_observation

if TYPE_CHECKING:
    from nowhere import Thing  # pyright: ignore[reportMissingImports]


class Everything:
    def __init__(
        self,
        steps: int,
        *,
        gain: float = 0.5,
        noisy: bool = False,
        name: str = "x",
        checkpoint: Path | None = None,
        mode: Literal["fast", "slow", 3] = "fast",
        limit: Optional[int] = None,  # noqa: UP045
        either: int | float | str = 0,
        language: str | LanguageBackend = "rules-v1",
        thing: Thing | None = None,
        untyped="u",
    ) -> None: ...


class Inherits(Everything):
    """Annotations are those of the module that wrote the constructor."""


def factory(n: int, **more: object) -> Everything:
    return Everything(n)


@pytest.mark.parametrize("made_by", [Everything, Inherits])
@pytest.mark.parametrize(
    ("name", "text", "value"),
    [
        ("steps", "-3", -3),
        ("gain", "1e-3", 0.001),
        ("noisy", "True", True),
        ("noisy", "0", False),
        ("name", "7", "7"),
        ("name", "", ""),
        ("checkpoint", "a/b.pt", Path("a/b.pt")),
        ("checkpoint", "none", None),
        ("mode", "slow", "slow"),
        ("mode", "3", 3),
        ("limit", "4", 4),
        ("limit", "None", None),
        ("either", "2", 2),
        ("either", "2.5", 2.5),
        ("either", "two", "two"),
        ("language", "live:m", "live:m"),
        ("thing", "what?", "what?"),
        ("untyped", "3", "3"),
    ],
)
def test_a_text_becomes_what_the_annotation_says(made_by: type, name: str, text: str, value: object) -> None:
    bound = bind(made_by, {"steps": "1"} | {name: text})
    assert bound[name] == value
    assert type(bound[name]) is type(value)


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({}, "it requires the argument 'steps': --policy-arg steps=VALUE"),
        ({"steps": "1.5"}, "argument 'steps': expected int, got '1.5'"),
        ({"steps": "1", "noisy": "maybe"}, "argument 'noisy': expected bool, got 'maybe'"),
        ({"steps": "1", "mode": "4"}, r"argument 'mode': expected fast \| slow \| 3, got '4'"),
        ({"steps": "1", "limit": "x"}, "argument 'limit': expected int, got 'x'"),
        ({"stops": "1"}, "it has no argument 'stops'"),
    ],
)
def test_what_does_not_fit_names_the_arguments_that_exist(given: dict[str, str], says: str) -> None:
    with pytest.raises(ArgumentError, match=says) as raised:
        bind(Everything, given)
    for listed in ("steps: int (required)", "gain: float = 0.5", "checkpoint: Path (optional)", "untyped: str = u"):
        assert listed in str(raised.value)


def test_a_factory_may_take_any_name() -> None:
    assert [str(parameter) for parameter in parameters_of(factory)] == ["n: int (required)"]
    assert bind(factory, {"n": "2", "other": "3"}) == {"n": 2, "other": "3"}


@pytest.mark.parametrize("annotation", ["list[int]", "tuple[float, ...]", "dict[str, int]", "list", "bytes"])
def test_a_container_is_refused_and_does_not_become_a_text(annotation: str) -> None:
    def made(sizes) -> None: ...

    made.__annotations__["sizes"] = annotation
    with pytest.raises(ArgumentError, match=r"argument 'sizes' is a .* let the constructor take a str and split it"):
        bind(made, {"sizes": "[1, 2]"})


def test_a_class_without_a_constructor_takes_nothing() -> None:
    class Plain: ...

    assert parameters_of(Plain) == ()
    with pytest.raises(ArgumentError, match="no argument 'steps'; its arguments: none"):
        bind(Plain, {"steps": "1"})


SHUT = "world sim sensing running recording recording.schema scoring stats report protocol cli contractual".split()


@pytest.mark.parametrize("name", ["mujoco", "mujoco.mjx", *(f"carecontact.{part}" for part in SHUT)])
def test_closed(name: str) -> None:
    with pytest.raises(ImportError, match=f"{name} is closed to policies") as caught:
        ImportWall().find_spec(name, None)
    assert caught.value.name == name


@pytest.mark.parametrize(
    "name",
    ["carecontact", "carecontact.errors", "carecontact.interface", "carecontact.policies.blind", "mujocolike"],
)
def test_open(name: str) -> None:
    assert ImportWall().find_spec(name, None) is None


def test_a_wall_raised_too_late_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    import sys

    monkeypatch.setitem(sys.modules, "carecontact.scoring", sys)
    with pytest.raises(RuntimeError, match="loaded before the import restrictions"):
        raise_wall()


def test_the_interface_and_the_examples_of_learners_import_nothing_closed() -> None:
    root = Path(__file__).parents[2]
    files = sorted((root / "src/carecontact/interface").glob("[a-z]*.py"))
    names = [f"carecontact.interface.{file.stem}" for file in files] + ["bc_lowdim"]
    code = "import sys; from carecontact.serving.child import raise_wall; raise_wall()"
    code = f"{code}; sys.path.insert(0, 'examples/learn'); import {', '.join(names)}"
    done = subprocess.run([sys.executable, "-c", code], cwd=root, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


POSES = [[0.4, 0.0, 0.4 - 0.01 * k, 0.0, 1.0, 0.0, 0.0] for k in range(5)]


@pytest.fixture
def made(tmp_path: Path) -> Witness:
    card = {"name": "other", "modalities": ["rgb"], "cameras": ["wrist"], "control_hz": 1.0}
    task = {"card": card, "control_hz": 20.0, "poses": POSES, "actions_per_look": 2}
    (tmp_path / TASK).write_text(json.dumps(task))
    return Witness(tmp_path)


def test_it_asks_for_what_the_other_asks_for_and_plays_its_poses(made: Witness) -> None:
    assert (made.card.name, made.card.modalities, made.card.cameras) == ("other", ("rgb",), ("wrist",))
    assert made.card.control_hz == 20.0
    made.reset("touch")
    chunks = [made.act(synthetic_observation()) for _ in range(3)]
    poses = [[a.pose_tcp_in_base.tolist() for a in chunk if a.pose_tcp_in_base is not None] for chunk in chunks]
    assert poses == [POSES[:2], POSES[2:4], POSES[4:]]
    assert [a.done for chunk in chunks for a in chunk] == [False, False, False, False, True]
    with pytest.raises(ContractError, match="after the last of 5 poses"):
        made.act(synthetic_observation())


def test_it_writes_down_what_reached_it(made: Witness, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CARECONTACT_SEED", "3")
    monkeypatch.setattr(sys, "orig_argv", ["python", "-c", "code"])
    for name, value in {
        "target": "a:B",
        "arguments": {"seed": "3"},
        "report_fd": 7,
        "lifeline_fd": 8,
        "harness_port": 9,
        "stack_fd": 9,
    }.items():
        monkeypatch.setitem(child.RECEIVED, name, value)
    made.configure(SESSION)
    with (tmp_path / "held").open("w"):
        made.reset("touch")
        received = json.loads((tmp_path / RECEIVED_FILE).read_text())
        if Path("/proc/self/fd").is_dir():
            assert str(tmp_path / "held") in received["open_files"]
    assert received["instruction"] == "touch"
    assert received["session"] == json.loads(json.dumps(codec.encode_session(SESSION)))
    assert received["environment"]["CARECONTACT_SEED"] == "3"
    assert received["command_line"] == ["python", "-c", "code"]
    assert received["options"] == {"target": "a:B", "arguments": {"seed": "3"}}
    assert received["folder"] == os.getcwd()


def test_what_has_something_to_read_or_ended_is_returned() -> None:
    ends = [os.pipe() for _ in range(3)]
    os.write(ends[0][1], b"x")
    os.close(ends[1][1])
    assert readable_descriptors([read for read, _ in ends]) == [ends[0][0], ends[1][0]]
    assert readable_descriptors([ends[2][0]], 0.01) == []
    assert readable_descriptors([], -1.0) == []
    for end in (*(read for read, _ in ends), ends[0][1], ends[2][1]):
        os.close(end)

"""`carecontact check ADDRESS`: the mistake of each faulty server is named, and good servers get no warning."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from carecontact.cli import main
from tests.running.servers import EXTERIOR, GRIPPER, WRIST, Seeing, SeeingArena, SeeingVla
from tests.serving.fakes import Fake

VELOCITY, POSITION = "openpi://127.0.0.1:{}?profile=pi05-droid", "openpi://127.0.0.1:{}?profile=pi05-droid-jointpos"
ARENA, VLA = "roboarena://127.0.0.1:{}", "vla-eval://127.0.0.1:{}"
Checked = Callable[[Fake, str], tuple[int, str]]

pytestmark = pytest.mark.usefixtures("same_world")


@pytest.fixture
def checked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Checked:
    monkeypatch.chdir(tmp_path)
    # On a busy machine any call may be slow, and of that other tests tell.
    monkeypatch.setattr("carecontact.running.check.Check._keeps_pace", lambda self, count, card: True)

    def check(server: Fake, address: str, *options: str) -> tuple[int, str]:
        with server.running() as port:
            status = main(["check", address.format(port), *options])
        return status, capsys.readouterr().out

    return check


def targets(chunk: np.ndarray, joints: np.ndarray) -> np.ndarray:
    return np.c_[joints + 0.2 * chunk[:, :7], chunk[:, 7]]


def with_gripper(chunk: np.ndarray, command: float) -> np.ndarray:
    return np.c_[chunk[:, :7], np.full(len(chunk), command)]


def with_nan(chunk: np.ndarray, joints: np.ndarray) -> np.ndarray:
    chunk[3, 2] = np.nan
    return chunk


@dataclass
class AsksForStereo(SeeingArena):
    @property
    def metadata(self) -> dict[str, Any]:
        return super().metadata | {"needs_stereo_camera": True}


FAULTS: dict[str, tuple[Callable[[], Fake], str, int, str, str]] = {
    "targets as velocities": (
        lambda: Seeing(spoil=targets), VELOCITY, 0, "warning  velocities", "they look like targets",
    ),
    "velocities as targets": (
        lambda: Seeing(spoil=lambda chunk, joints: chunk), POSITION, 0, "warning  targets", "look like velocities",
    ),
    "targets in degrees": (
        lambda: Seeing(spoil=lambda chunk, joints: np.degrees(targets(chunk, joints)) * ([1] * 7 + [0])), POSITION, 1,
        "error    answer", "the server answers in degrees?",
    ),
    "velocities in degrees": (
        lambda: Seeing(spoil=lambda chunk, joints: chunk * ([57.3] * 7 + [1])), VELOCITY, 0, "warning  degrees",
        "look like degrees",
    ),
    "velocities in rad/s": (
        lambda: Seeing(spoil=lambda chunk, joints: chunk * ([10] * 7 + [1])), VELOCITY, 0, "warning  velocities",
        "send normalised velocities, not rad/s",
    ),
    "ninth column": (
        lambda: Seeing(spoil=lambda chunk, joints: np.c_[chunk, chunk[:, 0]]), VELOCITY, 1, "error    answer",
        "10 steps of 9 columns; expected 8, seven joints and the gripper",
    ),
    "gripper far outside": (
        lambda: Seeing(spoil=lambda chunk, joints: with_gripper(chunk, -1)), VELOCITY, 1, "error    answer",
        "expected a gripper command of 0 (open) to 1 (closed) in the last column, got -1",
    ),
    "gripper a little outside": (
        lambda: Seeing(spoil=lambda chunk, joints: with_gripper(chunk, 1.3)), VELOCITY, 0, "warning  gripper",
        "from 1.30 to 1.30, expected 0 (open) to 1 (closed)",
    ),
    "chunk shorter than horizon": (
        lambda: Seeing(steps=5), VELOCITY, 1, "error    answer", "at least 8 steps, the horizon, got 5",
    ),
    "NaN": (lambda: Seeing(spoil=with_nan), VELOCITY, 1, "error    answer", "; 1 of 10 are not finite"),
    "ignored picture": (
        lambda: Seeing(blind=(WRIST,)), VELOCITY, 0, "warning  input", f"{WRIST} (camera wrist): no effect",
    ),
    "ignored picture, random otherwise": (
        lambda: Seeing(blind=(EXTERIOR,), noise=0.02), VELOCITY, 0, "warning  input",
        f"{EXTERIOR} (camera exterior): no effect",
    ),
    "ignored instruction": (
        lambda: Seeing(blind=("prompt",), targets=True), POSITION, 0, "warning  input", "prompt (instruction): no",
    ),
    "ignored picture, vla-eval": (
        lambda: SeeingVla(blind=("wrist_camera",)), VLA, 0, "warning  input", "wrist_camera (camera wrist): no effect",
    ),
    "more cameras than there are": (
        lambda: SeeingArena(external=3), ARENA, 1, "error    card",
        "n_external_cameras: expected 0 to 2 (exterior, bedside), got 3",
    ),
    "stereo camera": (AsksForStereo, ARENA, 1, "error    card", "no camera of this benchmark has two pictures"),
}  # fmt: skip
"""Mistake -> server, address, status, beginning of the line that names it, and what it says."""


@pytest.mark.parametrize("name", FAULTS)
def test_a_mistake_is_named(checked: Checked, name: str) -> None:
    make, address, status, begins, says = FAULTS[name]
    got, out = checked(make(), address)
    assert got == status, out
    assert begins in out
    assert says in out
    if status == 0:
        others = [line for line in out.splitlines() if line.startswith("warning") and not line.startswith(begins)]
        assert [line.split()[1] for line in others] in ([], ["clipped"]), out


def good(name: str, make: Callable[[], Fake], address: str, *, slow: bool = False) -> Any:
    return pytest.param(make, address, id=name, marks=pytest.mark.slow if slow else ())


@pytest.mark.parametrize(
    ("make", "address"),
    [
        good("velocities", lambda: Seeing(steps=15), VELOCITY),
        good("targets", lambda: Seeing(targets=True), POSITION),
        good("random velocities", lambda: Seeing(steps=15, noise=0.02), VELOCITY),
        good("random targets", lambda: Seeing(targets=True, noise=0.02), POSITION, slow=True),
        good("RoboArena", lambda: SeeingArena(external=2), ARENA),
        good("random RoboArena", lambda: SeeingArena(noise=0.02), ARENA, slow=True),
        good("vla-eval", SeeingVla, VLA),
        good("vla-eval with a buffer", lambda: SeeingVla(buffered=True), VLA),
        good("random vla-eval", lambda: SeeingVla(noise=0.02), VLA),
    ],
)
def test_a_good_server_gets_no_warning(checked: Checked, make: Callable[[], Fake], address: str) -> None:
    status, out = checked(make(), address)
    assert status == 0
    assert "\nwarning" not in out, out
    assert "\nerror" not in out
    assert "\nok       latency      p50" in out, out
    assert out.endswith("a run can work\n")


def test_the_report_on_a_good_server(checked: Checked, tmp_path: Path) -> None:
    server = SeeingArena(external=2)
    _, out = checked(server, ARENA, "--pictures", "sheet.png")
    assert "n_external_cameras   2  (how many exterior cameras it wants)" in out
    assert f"{WRIST}       uint8 (224, 224, 3)" in out
    assert "joint 4" in out
    assert "the angle is -1.8" in out
    assert "10 steps; all of them are executed, 0.67 s at 15 Hz" in out
    with Image.open(tmp_path / "sheet.png") as sheet:
        pixels = np.asarray(sheet.convert("RGB"))
    first = next(message for message in server.heard if message["endpoint"] == "infer")
    for key in (EXTERIOR, EXTERIOR.replace("1", "2"), WRIST):
        assert _contains(pixels, first[key]), key


def _contains(sheet: np.ndarray, picture: np.ndarray) -> bool:
    """Whether a picture stands somewhere in another, pixel for pixel."""
    height, width = picture.shape[:2]
    corners = np.argwhere((sheet[: -height + 1, : -width + 1] == picture[0, 0]).all(-1))
    return any((sheet[y : y + height, x : x + width] == picture).all() for y, x in corners)


def test_the_opposite_polarity_is_named(checked: Checked) -> None:
    @dataclass
    class Opposite(Seeing):
        given: list[float] = field(default_factory=list)

        def chunk(self, observation: dict[str, Any]) -> np.ndarray:
            return with_gripper(super().chunk(observation), 1 - float(observation[GRIPPER][0]))

    _, out = checked(Opposite(), VELOCITY)
    assert (
        "hint     gripper      the observation says that the gripper is closed, and the server commands an open" in out
    )
    assert "warning  gripper      where the gripper is observed as closed, the server commands an open one (0)" in out


def test_a_server_that_refuses_a_blanked_input_uses_it(checked: Checked) -> None:
    @dataclass
    class Refusing(Seeing):
        def pack(self, answer: Any) -> bytes | str:
            return "Traceback: unknown task" if self.heard[-1]["prompt"] == "do nothing" else super().pack(answer)

    server = Refusing(noise=0.02)
    status, out = checked(server, VELOCITY)
    assert status == 0
    assert "prompt (instruction): used; the policy refuses it blanked" in out
    assert out.endswith("a run can work\n")
    assert server.paths == ["/healthz", "/", "/"]


def test_a_key_that_the_server_repeats_is_not_shown(checked: Checked, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CARECONTACT_API_KEY", "very-secret")
    server = Seeing(metadata={"key": "very-secret", "checkpoint": "mine"})
    _, out = checked(server, VELOCITY)
    assert "Api-Key very-secret" in server.headers
    assert "very-secret" not in out
    assert "key         '***'" in out
    assert "checkpoint  'mine'" in out


def test_a_server_that_fails_later_is_an_error(checked: Checked) -> None:
    @dataclass
    class Failing(Seeing):
        def pack(self, answer: Any) -> bytes | str:
            return "Traceback: out of memory" if len(self.heard) == 5 else super().pack(answer)

    status, out = checked(Failing(), VELOCITY)
    assert status == 1
    assert "out of memory" in out


def test_a_plain_check_writes_nothing_and_asks_twice(checked: Checked, tmp_path: Path) -> None:
    server = Seeing()
    status, out = checked(server, VELOCITY, "--quick")
    assert status == 0
    assert len(server.heard) == 2
    assert "columns" not in out
    assert list(tmp_path.iterdir()) == []
    assert checked(server, VELOCITY, "--quick", "--deep")[0] == 2


def test_a_policy_that_starts_here_can_be_checked_deeply(tmp_path: Path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["check", "zero-action", "--deep"]) == 0
    out = capsys.readouterr().out
    assert "warning  input        observation.instruction (instruction): no effect" in out
    assert "hint     input        observation.joint_position (joint angles): no effect" in out


@pytest.mark.parametrize(("path", "says"), [("a.jpg", "ends in .png"), ("nowhere/a.png", "no folder nowhere")])
def test_a_place_that_no_sheet_can_have(path: str, says: str, tmp_path: Path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["check", "ws://127.0.0.1:9", "--pictures", path]) == 2
    assert says in capsys.readouterr().err

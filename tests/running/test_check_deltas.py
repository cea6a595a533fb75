"""`carecontact check` with servers that answer deltas: a wrong polarity, picture, axis, order and scale is named, and
good servers get no warning."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

from carecontact.cli import main
from carecontact.episode.episode import Episode
from carecontact.episode.randomization import World
from carecontact.interface.deltas import DELTAS
from carecontact.interface.geometry import pixels
from carecontact.interface.observation import CameraView, Observation
from carecontact.interface.policy import PolicyCard
from carecontact.protocol.load import load_protocol
from carecontact.protocol.protocol import TrialSpec
from carecontact.running.check_deltas import COLOURS, Questions, combined, drawn, fit, look_at_deltas, meanings, path_of
from carecontact.serving.cartesian import ORIENTATIONS
from tests.policies.synthetic import synthetic_observation
from tests.running.test_delta_servers import LIBERO_WORLD
from tests.serving.delta_servers import LIBERO_SPEC, Bridge, Driving, Libero, OnOpenpi, OnVlaEval
from tests.serving.fakes import Fake

LIBERO, BRIDGE, VLA = (
    "openpi://127.0.0.1:{}?profile=libero",
    "openpi://127.0.0.1:{}?profile=bridge",
    "vla-eval://127.0.0.1:{}?profile=libero",
)
pytestmark = pytest.mark.usefixtures("same_world")


@dataclass
class Looking(OnOpenpi):
    """A server that goes to its goal, and as far to the other side of where the tool begins if left and right of the
    exterior picture are not as in the pictures that it knows."""

    knows: str = "mirrored"
    weights: np.ndarray = field(default_factory=lambda: np.linspace(-1, 1, 224))
    start: np.ndarray = field(default_factory=lambda: np.zeros(3))
    """Where the tool begins, in the frame of the server's data set; set by the test."""
    upright: float = 0.0
    """Which half of the upright picture is brighter; set by the test."""

    def chunk(self, observation: dict[str, Any]) -> np.ndarray:
        goal, start = self.driver.goal, self.start
        flips = self.knows in ("mirrored", "turned")
        seen = float((observation["observation/image"].mean(axis=(0, 2)) * self.weights).sum())
        wrong = np.sign(seen) != np.sign(self.upright) * (-1 if flips else 1)
        # Every input has a little effect.
        told = sum(map(ord, observation["prompt"])) % 7 + float(np.mean(observation.get("observation/wrist_image", 0)))
        self.driver.goal = 2 * start - goal if wrong else goal
        rows = super().chunk(observation).copy()
        self.driver.goal = goal
        rows[:, :3] *= 1 + 1e-4 * told + 1e-6 * seen
        return rows.astype(np.float32)


@pytest.fixture
def scene(again: Callable[..., World]) -> tuple[np.ndarray, np.ndarray, Rotation, float]:
    """A place above the named region, the tool's place and its orientation, all in base, and which half of the exterior
    picture is brighter."""
    spec = TrialSpec(protocol=load_protocol(), task_id="T1", seed=0, policy="x")
    card = PolicyCard(name="x", modalities=("rgb",), cameras=("exterior",))
    with Episode(spec, card=card, prepare=again) as episode:
        seen = episode.reset()
        data = episode.simulation.data
        site = data.site(f"region_{episode.task.region}")
        place = episode.simulation.encoders.in_base(data, site.xpos, site.xmat)[:3, 3]
    rgb = seen.cameras["exterior"].rgb
    assert rgb is not None
    square = np.asarray(Image.fromarray(rgb[:, 140:500]).resize((224, 224), Image.Resampling.BILINEAR))
    brighter = float((square.mean(axis=(0, 2)) * np.linspace(-1, 1, 224)).sum())
    assert abs(brighter) > 50, "the picture has two halves"
    tool = seen.pose_tcp_in_base
    return place + [0, 0, 0.2], tool[:3], Rotation.from_quat(tool[3:], scalar_first=True), brighter


Checked = Callable[[Fake, str], tuple[int, str]]


@pytest.fixture
def checked(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    scene: tuple[np.ndarray, np.ndarray, Rotation, float],
) -> Checked:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("carecontact.running.check.Check._keeps_pace", lambda self, count, card: True)
    place, start, turn, brighter = scene

    def check(server: Any, address: str) -> tuple[int, str]:
        driver: Driving = server.driver
        driver.gain = 0.2
        shift = LIBERO_WORLD - turn.apply([0, 0, 0.0205]) if isinstance(driver, Libero) else np.zeros(3)
        driver.goal = place + shift
        driver.turn = turn if isinstance(driver, Libero) else turn * Rotation.from_rotvec([np.pi, 0, 0]).inv()
        if isinstance(server, Looking):
            server.upright, server.start = brighter, start + shift
        with server.running() as port:
            status = main(["check", address.format(port)])
        return status, capsys.readouterr().out

    return check


def in_tool(rows: np.ndarray) -> np.ndarray:
    """Of a server that means the tool's axes; the tool points down, turned by 30 degrees."""
    tool = Rotation.from_euler("z", 30, degrees=True) * Rotation.from_euler("x", 180, degrees=True)
    return np.c_[tool.inv().apply(rows[:, :3]), tool.inv().apply(rows[:, 3:6]), rows[:, 6]]


def spoilt(spoil: Callable[[np.ndarray], np.ndarray], kind: type[Driving] = Libero) -> Callable[[], Fake]:
    return lambda: Looking(driver=kind(spoil=spoil), knows="mirrored" if kind is Libero else "upright")


FAULTS: dict[str, tuple[Callable[[], Fake], str, int, str, str]] = {
    "polarity": (
        lambda: Looking(driver=Libero(spoil=lambda rows: rows * [1, 1, 1, 1, 1, 1, -1])), LIBERO, 0, "warning  gripper",
        "its polarity looks like the opposite of the profile's, where 1 is closed",
    ),
    "polarity of Bridge": (
        spoilt(lambda rows: np.c_[rows[:, :6], 1 - rows[:, 6]], Bridge), BRIDGE, 0, "warning  gripper",
        "its polarity looks like the opposite of the profile's, where 0 is closed",
    ),
    "gripper as the checkpoint has it": (
        spoilt(lambda rows: np.c_[rows[:, :6], 0 * rows[:, 6]]), LIBERO, 0, "warning  gripper",
        "neither -1 (open) nor 1 (closed): it looks like a checkpoint's own range",
    ),
    "pictures not mirrored": (
        lambda: Looking(driver=Libero(), knows="upright"), LIBERO, 0, "warning  orientation",
        "as with pictures upright or upside-down (1.00)",
    ),
    "pictures mirrored of Bridge": (
        lambda: Looking(driver=Bridge(), knows="turned"), BRIDGE, 0, "warning  orientation",
        "orientation=mirrored to the address",
    ),
    "rotation in the order z y x": (
        spoilt(lambda rows: rows[:, [0, 1, 2, 5, 4, 3, 6]]), LIBERO, 0, "warning  axes",
        "the rotation of the answer does not bring it back in the declared axes (fit 0.33), but would if it were "
        "meant in the order z y x (1.00)",
    ),
    "rotation in the order z y x of Bridge": (
        spoilt(lambda rows: rows[:, [0, 1, 2, 5, 4, 3, 6]], Bridge), BRIDGE, 0, "warning  axes", "the order z y x",
    ),
    "axes of the tool": (spoilt(in_tool), LIBERO, 0, "warning  axes", "in the axes of the tool"),
    "opposite sign": (
        spoilt(lambda rows: rows * [1, 1, 1, -1, -1, -1, 1]), LIBERO, 0, "warning  axes", "in the opposite sign",
    ),
    "metres in the place of shares": (
        spoilt(lambda rows: rows * [*[0.05] * 3, *[0.5] * 3, 1]),
        LIBERO, 0, "hint     deltas", "if metres are meant, the profile is wrong",
    ),
    "shares in the place of metres": (
        spoilt(lambda rows: rows * [*[20] * 3, *[4] * 3, 1], Bridge), BRIDGE, 0, "warning  deltas",
        "of the steps have a translation beyond 0.05",
    ),
    "eighth column": (
        spoilt(lambda rows: np.c_[rows, rows[:, 0]]), LIBERO, 1, "error    answer",
        "10 steps of 8 columns; expected 7, three of translation, three of rotation and the gripper",
    ),
    "no gripper": (spoilt(lambda rows: rows[:, :6]), LIBERO, 1, "error    answer", "the gripper's column is missing"),
    "another spec": (
        lambda: OnVlaEval(payload={"action_spec": LIBERO_SPEC | {"rotation": {"dims": 3, "format": "euler_xyz"}}}),
        VLA, 1, "error    card", "rotation (3 of 'euler_xyz'), and the profile libero expects",
    ),
}  # fmt: skip
"""Mistake -> server, address, status, beginning of the line that names it, and what it says."""


@pytest.mark.parametrize("name", FAULTS)
def test_a_mistake_is_named(checked: Checked, name: str) -> None:
    make, address, status, begins, says = FAULTS[name]
    got, out = checked(make(), address)
    assert got == status, out
    assert begins in out, out
    assert says in " ".join(out.split()), out
    if status == 0:
        others = [line for line in out.splitlines() if line.startswith("warning") and not line.startswith(begins)]
        assert not [line for line in others if line.split()[1] != "deltas"], out


def test_a_server_that_uses_no_picture_says_nothing_of_their_orientation(checked: Checked) -> None:
    _, out = checked(OnOpenpi(driver=Libero()), LIBERO)
    assert "ok       orientation" not in out
    assert "leads the same way however the pictures are turned" in " ".join(out.split())


@pytest.mark.parametrize(
    ("make", "address"),
    [
        (lambda: Looking(driver=Libero()), LIBERO),
        (lambda: Looking(driver=Bridge(), knows="upright"), BRIDGE),
        (lambda: Looking(driver=Libero(), knows="turned"), LIBERO + "&orientation=turned"),
    ],
    ids=["LIBERO", "Bridge", "turned"],
)
def test_a_good_server_gets_no_warning(checked: Checked, make: Callable[[], Fake], address: str) -> None:
    status, out = checked(make(), address)
    assert status == 0
    assert "\nwarning" not in out, out
    assert "the translation brings back a tool that is moved in the observation" in out
    assert "the rotation brings back a tool that is turned in the observation" in out
    assert "the answer leads to the named region" in out
    with Image.open("check-pictures.png") as sheet:
        colours = {tuple(c) for c in np.unique(np.asarray(sheet.convert("RGB")).reshape(-1, 3), axis=0).tolist()}
    assert set(COLOURS) & colours, "arrows"


# The parts by themselves.


def test_arrows_point_where_the_axes_do_and_leave_the_observation_alone() -> None:
    """A camera over the tool that looks down: right is +x of the base, down is -y."""
    white = np.full((480, 640, 3), 255, np.uint8)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = np.diag([1.0, -1.0, -1.0]), [0.4, 0.0, 1.5]
    intrinsics = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])
    view = CameraView(intrinsics=intrinsics, pose_camera_in_base=pose, rgb=white)
    seen = synthetic_observation(cameras={"overhead": view})
    seen = replace(seen, pose_tcp_in_base=np.array([0.4, 0.0, 0.5, 0, 1, 0, 0]))
    shown = drawn(seen, np.array([[0, 0, 0, 0, 0, 0]] * 3), DELTAS["osc"]).cameras["overhead"].rgb
    assert shown is not None
    places = [np.argwhere((shown == colour).all(axis=2)).mean(axis=0) for colour in COLOURS]
    assert places[0][1] > 335
    assert abs(places[0][0] - 240) < 3
    assert places[1][0] < 225
    assert abs(places[1][1] - 320) < 3
    assert (white == 255).all()
    tip = pixels(np.array([0.5, 0.0, 0.5]), intrinsics, pose)
    assert tuple(shown[round(tip[1]), round(tip[0])]) == COLOURS[0]


def test_the_way_of_an_answer_is_that_of_its_deltas_one_after_the_other() -> None:
    pose = np.array([0.4, 0.0, 0.5, 0, 1, 0, 0])
    way = path_of(np.array([[1, 0, 0, 0, 0, 0], [0, 2.0, 0, 0, 0, 0]]), pose, DELTAS["osc"])
    np.testing.assert_allclose(way - pose[:3], [[0, 0, 0], [0.05, 0, 0], [0.05, 0.05, 0]], atol=1e-12)


def test_turning_pictures_twice() -> None:
    assert combined("mirrored", "turned") == "upside-down"
    for name in ORIENTATIONS:
        assert combined(name, name) == "upright"
        assert combined("upright", name) == name


def test_a_response_fits_the_meaning_that_made_it() -> None:
    tool = np.array([0, 0, 0, *Rotation.from_euler("xyz", [170, 8, 35], degrees=True).as_quat(scalar_first=True)])
    for convention in (DELTAS["osc"], DELTAS["metres-tool"]):
        known = meanings(tool, convention)
        assert known[0].name == ""
        for one in known:
            found = max(known, key=lambda other: round(fit(-0.3 * one.matrix, other.matrix), 6))
            assert fit(-0.3 * one.matrix, one.matrix) == pytest.approx(1)
            np.testing.assert_allclose(found.matrix, one.matrix, atol=1e-12)
    # One axis that answers is enough for its part.
    only_z = np.diag([0.0, 0.0, -0.5])
    assert fit(only_z, np.eye(3)) == pytest.approx(1)
    assert fit(np.zeros((3, 3)), np.eye(3)) == 0


def test_absolute_positions_in_the_place_of_deltas_are_named() -> None:
    tool = np.array([0.4, 0.1, 0.5, 0, 1, 0, 0])
    rows = np.tile([*tool[:3], 0, 0, 0], (3, 1))
    found = list(look_at_deltas(rows, DELTAS["bridge"], tool))
    assert [one.level for one in found] == ["warning"]
    assert "look like absolute positions of the tool" in found[0].text
    assert not list(look_at_deltas(0.1 * np.ones((3, 6)), DELTAS["osc"], tool))


def test_chance_alone_gives_no_warning_and_hides_no_response() -> None:
    """Forty policies that follow nothing, and forty whose translation brings the tool back."""
    convention, rng = DELTAS["osc"], np.random.default_rng(1)
    seen = replace(synthetic_observation(), pose_tcp_in_base=np.array([0.4, 0.1, 0.5, 0, 1, 0, 0]))
    goal = np.array([0.5, 0.1, 0.4])

    def asked(ask: Callable[[Observation], np.ndarray]) -> list[tuple[str, str]]:
        questions = Questions(ask, seen, convention, [ask(seen) for _ in range(4)])
        return [(one.level, one.text[:15]) for one in questions.run(region_m=None, orientation="upright")]

    for _ in range(40):
        assert [level for level, _ in asked(lambda _: rng.normal(0, 0.3, (1, 6)))] == ["hint", "hint"]
        found = asked(lambda at: np.r_[6 * (goal - at.pose_tcp_in_base[:3]), 0, 0, 0] + rng.normal(0, 0.05, (1, 6)))
        assert found[0] == ("ok", "the translation")
        assert found[1][0] == "hint"


def test_a_policy_that_refuses_a_moved_tool_and_pictures_without_a_way() -> None:
    seen = replace(synthetic_observation(), pose_tcp_in_base=np.array([0.4, 0.1, 0.5, 0, 1, 0, 0]))
    questions = Questions(lambda at: None, seen, DELTAS["osc"], [np.zeros((1, 6))])
    found = list(questions.run(region_m=np.array([0.5, 0.3, 0.2]), orientation="upright"))
    assert [one.level for one in found] == ["hint", "hint"]
    assert all("refuses an observation of a tool that is elsewhere" in one.text for one in found)

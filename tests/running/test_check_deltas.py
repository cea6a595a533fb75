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
from carecontact.running.check_arrows import COLOURS, with_arrows
from carecontact.running.check_deltas import Questions, absolute, combined, fit, look_at_deltas, meanings, path_of
from carecontact.serving.cartesian import ORIENTATIONS
from tests.policies.synthetic import synthetic_observation
from tests.running.test_delta_servers import LIBERO_WORLD
from tests.serving.delta_servers import (
    LIBERO_SPEC,
    Bridge,
    Driving,
    Libero,
    OnOpenpi,
    OnVlaEval,
    robosuite_quat2mat,
)
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


@dataclass
class Clipped(Libero):
    """A controller that reaches the bound of every number within centimetres of its goal, and within a few degrees."""

    def row(self, state: np.ndarray) -> np.ndarray:
        shift = 4 * (self.goal - state[:3]) / 0.05
        turn = 12 * (self.turn * robosuite_quat2mat(state[3:6]).inv()).as_rotvec()
        return np.array([*np.clip([*shift, *turn], -1, 1), 1.0 if state[6] - state[7] < 0.04 else -1.0])


@dataclass
class Scaled(Libero):
    """Another one, which keeps the direction: only the largest number reaches the bound."""

    def row(self, state: np.ndarray) -> np.ndarray:
        row = super().row(state)
        shift = self.goal - state[:3]
        return np.array([*(shift / np.abs(shift).max()), *row[3:]])


@dataclass
class AbsoluteLibero(Libero):
    """Answers the pose of the next step, in the frame of its state."""

    def row(self, state: np.ndarray) -> np.ndarray:
        return np.array([*(state[:3] + 0.1 * (self.goal - state[:3])), *state[3:6], super().row(state)[6]])


@dataclass
class AbsoluteBridge(Bridge):
    """The same of Bridge."""

    def row(self, state: np.ndarray) -> np.ndarray:
        return np.array([*(state[:3] + 0.1 * (self.goal - state[:3])), *state[3:6], super().row(state)[6]])


@dataclass
class Turning(Libero):
    """Always turns by a quarter of a radian about x besides."""

    def row(self, state: np.ndarray) -> np.ndarray:
        return super().row(state) + [0, 0, 0, 0.5, 0, 0, 0]


@dataclass
class Goal(Libero):
    """Answers the pose of its goal, wherever the tool is."""

    def row(self, state: np.ndarray) -> np.ndarray:
        return np.array([*self.goal, *self.turn.as_rotvec(), super().row(state)[6]])


@dataclass
class Onward(Libero):
    """Moves on in one direction, whatever it is shown."""

    def row(self, state: np.ndarray) -> np.ndarray:
        return np.array([0.5, -0.2, -1.0, 0, 0, 0.3, super().row(state)[6]])


@pytest.fixture
def scene(again: Callable[..., World]) -> tuple[np.ndarray, np.ndarray, Rotation, float]:
    """A place above the named region, the tool's place and its orientation, all in base, and which half of the exterior
    picture is brighter."""
    spec = TrialSpec(protocol=load_protocol("bathing-v3"), task_id="T1", seed=0, policy="x")
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
    return lambda: Looking(driver=kind(spoil=spoil), knows="mirrored" if issubclass(kind, Libero) else "upright")


def flipped(axis: str, kind: type[Driving] = Libero) -> Callable[[], Fake]:
    signs = [-1 if name == axis else 1 for name in ("x", "y", "z", "", "", "", "")]
    return spoilt(lambda rows: rows * signs, kind)


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
        "goes from 0.00 to 0.00, and never to -1, though -1 is open and 1 is closed: it looks like a checkpoint's own",
    ),
    "gripper from 0 to 1": (
        spoilt(lambda rows: np.c_[rows[:, :6], (1 + rows[:, 6]) / 2]), LIBERO, 0, "warning  gripper",
        "goes from 0.00 to 1.00, and never to -1",
    ),
    "pictures not mirrored": (
        lambda: Looking(driver=Libero(), knows="upright"), LIBERO, 0, "warning  orientation",
        "as with pictures upright or upside-down (1.00)",
    ),
    "pictures mirrored of Bridge": (
        lambda: Looking(driver=Bridge(), knows="turned"), BRIDGE, 0, "warning  orientation",
        "add orientation=mirrored or orientation=turned to the address",
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
    "flipped x": (flipped("x"), LIBERO, 0, "warning  axes", "if it were meant in the opposite sign of x ("),
    "flipped y of Bridge": (
        flipped("y", Bridge), BRIDGE, 0, "warning  axes", "if it were meant in the opposite sign of y (",
    ),
    "x and y exchanged": (
        spoilt(lambda rows: rows[:, [1, 0, 2, 3, 4, 5, 6]]), LIBERO, 0, "warning  axes", "meant in the order y x z",
    ),
    "flipped x at the bounds": (
        flipped("x", Clipped), LIBERO, 0, "warning  axes", "if it were meant in the opposite sign of x (",
    ),
    "flipped z of a direction": (
        flipped("z", Scaled), LIBERO, 0, "warning  axes", "if it were meant in the opposite sign of z",
    ),
    "flipped turn at the bounds": (
        spoilt(lambda rows: rows * [1, 1, 1, 1, -1, 1, 1], Clipped), LIBERO, 0, "warning  axes",
        "the rotation of the answer does not bring it back in the declared axes (fit 0.33), but would if it were "
        "meant in the opposite sign of y",
    ),
    "x and y exchanged at the bounds": (
        spoilt(lambda rows: rows[:, [1, 0, 2, 3, 4, 5, 6]], Clipped), LIBERO, 0, "warning  axes",
        "meant in the order y x z",
    ),
    "absolute poses": (
        lambda: Looking(driver=AbsoluteLibero()), LIBERO, 0, "warning  deltas",
        "look like absolute positions of the tool, and differences are expected: the first translation is",
    ),
    "absolute poses in the frame of the base": (
        spoilt(lambda rows: rows - [*LIBERO_WORLD, 0, 0, 0, 0], AbsoluteLibero), LIBERO, 0, "warning  deltas",
        "m in base; declared",
    ),
    "absolute poses of Bridge": (
        spoilt(lambda rows: rows, AbsoluteBridge), BRIDGE, 0, "warning  deltas", "look like absolute positions",
    ),
    "the absolute pose of the goal": (
        lambda: Looking(driver=Goal()), LIBERO, 0, "warning  deltas", "which is the tool's own orientation in base",
    ),
    "rotation in degrees": (
        spoilt(lambda rows: rows * [1, 1, 1, *[0.5 * 180 / np.pi] * 3, 1], Turning), LIBERO, 0, "warning  deltas",
        "The numbers look like degrees",
    ),
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


SLOW = (
    "flipped y of Bridge",
    "flipped z of a direction",
    "flipped turn at the bounds",
    "x and y exchanged at the bounds",
    "absolute poses in the frame of the base",
    "the absolute pose of the goal",
    "rotation in degrees",
)
"""Their parts are tested below without a server."""


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow) if name in SLOW else name for name in FAULTS]
)
def test_a_mistake_is_named(checked: Checked, name: str) -> None:
    make, address, status, begins, says = FAULTS[name]
    got, out = checked(make(), address)
    assert got == status, out
    assert begins in out, out
    assert says in " ".join(out.split()), out
    if status == 0:
        others = [line for line in out.splitlines() if line.startswith("warning") and not line.startswith(begins)]
        assert not others, out


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
        (lambda: Looking(driver=Clipped()), LIBERO),
        (lambda: Looking(driver=Scaled()), LIBERO),
    ],
    ids=["LIBERO", "Bridge", "turned", "at the bounds", "a direction at the bound"],
)
def test_a_good_server_gets_no_warning(checked: Checked, make: Callable[[], Fake], address: str) -> None:
    status, out = checked(make(), address)
    assert status == 0
    assert "\nwarning" not in out, out
    assert "the translation brings back a tool that is moved in the observation" in out
    assert "the rotation brings back a tool that is turned in the observation" in out
    assert "the answer leads to the named region" in out
    assert "hint     axes" not in out
    with Image.open("check-pictures.png") as sheet:
        assert any((np.asarray(sheet.convert("RGB")) == colour).all(axis=2).any() for colour in COLOURS), "arrows"


def test_nothing_is_learned_of_the_axes_of_a_server_that_always_moves_on(checked: Checked) -> None:
    status, out = checked(OnOpenpi(driver=Onward()), LIBERO)
    assert status == 0
    seen = [line for line in out.splitlines() if line.split()[1] in ("axes", "orientation", "deltas")]
    assert [line.split()[0] for line in seen] == ["hint"] * 3, out
    assert "the translation hardly changes wherever the tool is moved in the observation: nothing can be learned" in out


# The parts by themselves.


def overhead() -> Observation:
    """A camera over the tool that looks down: right is +x of the base, down is -y."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = np.diag([1.0, -1.0, -1.0]), [0.4, 0.0, 1.5]
    intrinsics = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])
    grey = np.full((480, 640, 3), 128, np.uint8)
    seen = synthetic_observation(
        cameras={"overhead": CameraView(intrinsics=intrinsics, pose_camera_in_base=pose, rgb=grey)}
    )
    return replace(seen, pose_tcp_in_base=np.array([0.4, 0.0, 0.5, 0, 1, 0, 0]))


TURNS = {
    "as the camera sees": (lambda image: image, lambda uv: uv),
    "mirrored": (lambda image: image[:, ::-1], lambda uv: [639 - uv[0], uv[1]]),
    "cut, halved and padded": (
        lambda image: np.pad(
            np.asarray(Image.fromarray(image[:, 80:560]).resize((240, 240))), ((20, 20), (0, 0), (0, 0))
        ),
        lambda uv: [(uv[0] - 80 - 0.5) / 2, (uv[1] - 0.5) / 2 + 20],
    ),
}  # fmt: skip
"""How pictures (480, 640, 3) are changed on their way -> where a pixel arrives."""


@pytest.mark.parametrize("name", TURNS)
def test_arrows_point_where_the_axes_do_however_pictures_are_turned(name: str) -> None:
    turn, place = TURNS[name]
    seen = overhead()

    def sent(observation: Observation) -> dict[str, np.ndarray]:
        rgb = observation.cameras["overhead"].rgb
        assert rgb is not None
        return {"image": np.ascontiguousarray(turn(rgb)), "other": np.zeros((8, 8, 3), np.uint8)}

    shown = with_arrows(seen, np.zeros((3, 6)), DELTAS["osc"], sent=sent, cameras={"image": "overhead"})
    assert list(shown) == ["image"]
    picture, caption = shown["image"]
    scale = picture.shape[1] // sent(seen)["image"].shape[1]
    length = float(caption.split()[2]) / 1000
    camera, origin = seen.cameras["overhead"], seen.pose_tcp_in_base[:3]
    for axis, colour in list(zip(np.eye(3), COLOURS, strict=True))[:2]:
        tip = pixels(np.array([origin, origin + length * axis]), camera.intrinsics, camera.pose_camera_in_base)
        ends = (np.array([place(uv) for uv in tip]) + 0.5) * scale
        drawn = np.argwhere((picture == colour).all(axis=2))[:, ::-1]
        for end in ends:
            assert np.linalg.norm(drawn - end, axis=1).min() < 9, "the arrow goes from the tool to its tip"
        way = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
        beside = np.abs((drawn - ends[0]) @ [-way[1], way[0]])
        assert np.median(beside) < 10, "the rest is a label"


def test_arrows_that_leave_the_picture_are_cut_and_a_tool_outside_has_none() -> None:
    seen = overhead()
    grey = seen.cameras["overhead"].rgb
    assert grey is not None

    def drawn(place: list[float]) -> tuple[np.ndarray, str]:
        at = replace(seen, pose_tcp_in_base=np.array([*place, 0, 1, 0, 0]))
        sent = lambda observation: {"image": observation.cameras["overhead"].rgb}  # noqa: E731
        return with_arrows(at, np.zeros((1, 6)), DELTAS["osc"], sent=sent, cameras={"image": "overhead"})["image"]

    picture, _ = drawn([0.9, 0.3, 0.5])
    assert (picture[:, -3:] == COLOURS[0]).all(axis=2).any(), "+x leaves it to the right"
    picture, caption = drawn([3.0, 0.0, 0.5])
    assert caption == "the tool is outside"
    np.testing.assert_array_equal(picture, grey)
    assert drawn([0.4, 0.0, 2.0])[1] == "the tool is outside", "behind the camera"


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
        assert known[0].mistakes == ()
        for one in known:
            found = max(known, key=lambda other: round(fit(-0.3 * one.matrix, other.matrix), 6))
            assert fit(-0.3 * one.matrix, one.matrix) == pytest.approx(1)
            np.testing.assert_allclose(found.matrix, one.matrix, atol=1e-12)
    # One axis that answers is enough for its part.
    only_z = np.diag([0.0, 0.0, -0.5])
    assert fit(only_z, np.eye(3)) == pytest.approx(1)
    assert fit(np.zeros((3, 3)), np.eye(3)) == 0


def test_absolute_poses_in_the_place_of_deltas_are_named() -> None:
    tool = np.array([0.4, 0.1, 0.5, 0, 1, 0, 0])
    assert "the tool is at 0.40 0.10 0.50 m in base" in absolute(np.r_[tool[:3] + 0.02, 0, 0, 0], tool, None)
    sent = np.array([-0.2, 0.1, 1.2])
    assert "in the state that is sent" in absolute(np.r_[sent, 0, 0, 0], tool, sent)
    assert "own orientation" in absolute(np.array([0, 0, 0, 3.1, 0, 0]), tool, None)
    for delta in ([0.05, 0, -0.05, 0, 0, 0], [1, 1, -1, 0, 0, 0], [0, 0, 0, 1, 1, -1], [0, 0, 0, 0, 30, 0]):
        assert absolute(np.array(delta, float), tool, sent) == ""
    assert not list(look_at_deltas(0.1 * np.ones((3, 6)), DELTAS["osc"]))
    (degrees,) = look_at_deltas(np.array([[0.5, 0, 0, 14, 0, 0]]), DELTAS["osc"])
    assert "look like degrees" in degrees.text


SPOILT: dict[str, tuple[Callable[[np.ndarray], np.ndarray], str]] = {
    "right": (lambda row: row, ""),
    "x flipped": (lambda row: row * [-1, 1, 1], "the opposite sign of x ("),
    "y and z flipped": (lambda row: row * [1, -1, -1], "the opposite sign of y and the opposite sign of z"),
    "all flipped": (lambda row: -row, "the opposite sign ("),
    "x and y exchanged": (lambda row: row[[1, 0, 2]], "the order y x z ("),
}
"""Mistake in the numbers of a part -> what names it."""
LIMITS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "none": lambda row: 2 * row,
    "each number": lambda row: np.clip(30 * row, -1, 1),
    "the largest": lambda row: row / np.abs(row).max(),
}


@pytest.mark.parametrize("limit", LIMITS)
@pytest.mark.parametrize("name", SPOILT)
def test_a_wrong_part_is_named_also_where_numbers_stand_at_their_limits(name: str, limit: str) -> None:
    """Translation and rotation in turn have the mistake; the other part is right."""
    spoil, says = SPOILT[name]
    # The tool neither points down nor lies along an axis, so that no axes of the tool are those of the base.
    pose = np.r_[0.4, 0.1, 0.5, Rotation.from_euler("xyz", [150, 20, 35], degrees=True).as_quat(scalar_first=True)]
    seen, goal = replace(synthetic_observation(), pose_tcp_in_base=pose), np.array([0.62, -0.08, 0.2])
    turn = Rotation.from_rotvec([0.4, -0.3, 0.5]) * Rotation.from_quat(pose[3:], scalar_first=True)
    for part in (0, 1):

        def ask(at: Observation, part: int = part) -> np.ndarray:
            now = Rotation.from_quat(at.pose_tcp_in_base[3:], scalar_first=True)
            rows = [goal - at.pose_tcp_in_base[:3], (turn * now.inv()).as_rotvec()]
            rows = [LIMITS[limit](row) for row in rows]
            rows[part] = spoil(rows[part])
            return np.concatenate(rows)[None]

        found = list(Questions(ask, seen, DELTAS["osc"], [ask(seen)]).run(region_m=None, orientation="upright"))
        levels = ["ok", "ok"]
        levels[part] = "warning" if says else "ok"
        assert [one.level for one in found] == levels, [one.text for one in found]
        assert says in found[part].text


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

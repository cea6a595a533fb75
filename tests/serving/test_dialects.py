"""Exactly the pixels that every profile sends, as the server finds them, against stored pictures.

Each camera shows four corners of different colours on a ground of its own; a picture of 4:3 has white bars, which lie
outside 16:9. `python -m tests.serving.test_dialects` writes the stored pictures again: look at them.
"""

from __future__ import annotations

import random
import subprocess
import sys
import urllib.request
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import msgpack
import numpy as np
import pytest
from PIL import Image

from carecontact.errors import PolicyError
from carecontact.interface.observation import CameraView
from carecontact.interface.policy import PolicyCard
from carecontact.serving.client import Client
from carecontact.serving.connection import Connection
from carecontact.serving.dialect import announced_profile, named_profile
from carecontact.serving.dialect_media import cropped, padded, stretched
from carecontact.serving.openpi import OpenpiClient
from carecontact.serving.packing import pack
from carecontact.serving.vla_eval import VlaEvalClient
from tests.policies.synthetic import SESSION
from tests.serving import test_fuzz
from tests.serving.fakes import (
    INSTRUCTION,
    SIZES,
    Fake,
    Openpi,
    OpenpiPositions,
    RoboArena,
    VlaEval,
    actions,
    joints,
    picture,
    policy_at,
    seen,
    talk,
)
from tests.serving.fuzz import LAYERS, Plain, framed, spoilt, spoilt_transport

FOLDER = Path(__file__).parents[1] / "data" / "dialects"
GROUNDS = {"exterior": (200, 160, 40), "wrist": (40, 120, 200), "bedside": (150, 60, 170)}
CORNERS = {(0, 0): (250, 20, 10), (0, -1): (15, 230, 30), (-1, 0): (20, 10, 240), (-1, -1): (245, 235, 20)}
"""Top left red, top right green, bottom left blue, bottom right yellow."""
BAR = (255, 255, 255)
EXTERIOR, WRIST = "observation/exterior_image_{}_left", "observation/wrist_image_left"


def camera(name: str, *, height: int, width: int = 640) -> CameraView:
    """A corner covers a quarter of each side of the part of 16:9."""
    rgb = np.full((height, width, 3), BAR, np.uint8)
    high = width * 9 // 16
    part = rgb[(height - high) // 2 :][:high]
    part[:] = GROUNDS[name]
    for (y, x), colour in CORNERS.items():
        rows, columns = (
            (slice(0, high // 4), slice(-(high // 4), None)),
            (slice(0, width // 4), slice(-(width // 4), None)),
        )
        part[rows[y], columns[x]] = colour
    return CameraView(intrinsics=np.eye(3), pose_camera_in_base=np.eye(4), rgb=rgb)


@dataclass(frozen=True)
class Case:
    make: Callable[[], Fake]
    address: str
    keys: dict[str, str]
    """Key of a picture -> camera."""
    shape: tuple[int, int]
    pad: int = 0
    """Black rows above and below."""


DROID = {EXTERIOR.format(1): "exterior", WRIST: "wrist"}
ARENA = {EXTERIOR.format(0): "exterior", EXTERIOR.format(1): "bedside", WRIST: "wrist"}
CASES = {
    "pi05-droid": Case(Openpi, "openpi://127.0.0.1:{}?profile=pi05-droid", DROID, (224, 224), 49),
    "pi05-droid-jointpos": Case(
        OpenpiPositions, "openpi://127.0.0.1:{}?profile=pi05-droid-jointpos", DROID, (224, 224), 49
    ),
    "roboarena": Case(lambda: RoboArena(external=2, first=0), "roboarena://127.0.0.1:{}?exterior=0", ARENA, (224, 224)),
    "roboarena-as-captured": Case(
        lambda: RoboArena(external=2, first=0, resolution=None),
        "roboarena://127.0.0.1:{}?exterior=0",
        ARENA,
        (288, 512),
    ),
    "vla-eval": Case(
        VlaEval, "vla-eval://127.0.0.1:{}", {"exo_camera_1": "exterior", "wrist_camera": "wrist"}, (360, 640)
    ),
}


def sent(case: Case) -> dict[str, np.ndarray]:
    """Key -> picture, as a server decodes its first observation."""
    server = case.make()
    views = {"exterior": camera("exterior", height=360)}
    views |= {"wrist": camera("wrist", height=480), "bedside": camera("bedside", height=482)}
    with server.running() as port, policy_at(case.address.format(port)) as policy:
        policy.start()
        policy.reset(INSTRUCTION, SESSION)
        policy.act(replace(seen(), cameras=views))
    heard: list[dict[str, Any]] = [message.get("payload", message) for message in server.heard]
    shown = next(message for message in heard if "prompt" in message or "images" in message)
    images = {key: value for key, value in shown.items() if "image_" in key}
    return images or shown["images"]


def beside(images: dict[str, np.ndarray]) -> np.ndarray:
    return np.concatenate(list(images.values()), axis=1)


@pytest.mark.parametrize("name", CASES)
def test_what_is_sent_is_the_stored_picture(name: str) -> None:
    with Image.open(FOLDER / f"{name}.png") as golden:
        assert (beside(sent(CASES[name])) == np.asarray(golden)).all()


@pytest.mark.parametrize("name", CASES)
def test_colours_corners_cameras_and_padding(name: str) -> None:
    case = CASES[name]
    images = sent(case)
    assert list(images) == list(case.keys)
    for key, image in images.items():
        height, width = case.shape
        assert image.shape == (height, width, 3)
        assert not image[: case.pad].any()
        assert not image[height - case.pad :].any()
        shown = image[case.pad : height - case.pad].astype(int)
        high = len(shown)
        for (y, x), colour in CORNERS.items():
            inside = shown[(high // 8, -(high // 8))[y], (width // 8, -(width // 8))[x]]
            assert abs(inside - colour).max() <= 2, (key, y, x)
        assert abs(shown[high // 2, width // 2] - GROUNDS[case.keys[key]]).max() <= 2, key
        # No bar of a picture of 4:3 is left: the outermost row has the colours of the corners and the ground.
        assert (shown[0].min(-1) < 200).all(), key


# Pictures as openpi's and RoboArena's clients make them.

RESIZED = np.load(Path(__file__).parents[1] / "data" / "openpi" / "resized.npz")


@pytest.mark.parametrize(("given", "wanted"), SIZES)
def test_resizing_gives_the_bytes_of_openpis_image_tools(given: tuple[int, int], wanted: tuple[int, int]) -> None:
    expected = RESIZED[f"{given[0]}x{given[1]}-{wanted[0]}x{wanted[1]}"]
    np.testing.assert_array_equal(padded(picture(*given), wanted), expected, strict=True)


def test_a_picture_of_16_9_is_centred_on_black() -> None:
    image = padded(np.full((360, 640, 3), 9, np.uint8), (224, 224))
    assert not image[:49].any()
    assert not image[-49:].any()
    assert (image[49:-49] == 9).all()


@pytest.mark.parametrize(
    ("given", "rows", "columns"),
    [
        ((360, 640), slice(0, 360), slice(0, 640)),
        ((480, 640), slice(60, 420), slice(0, 640)),
        ((360, 800), slice(0, 360), slice(80, 720)),
    ],
)
def test_cutting_keeps_the_middle(given: tuple[int, int], rows: slice, columns: slice) -> None:
    image = picture(*given)
    np.testing.assert_array_equal(cropped(image, (16, 9)), image[rows, columns])


def test_roboarena_stretches_with_lanczos_by_way_of_its_captured_size() -> None:
    image = picture(360, 640)
    captured = Image.fromarray(image).resize((512, 288), Image.LANCZOS)
    np.testing.assert_array_equal(stretched(image, None), np.array(captured), strict=True)
    expected = np.array(captured.resize((224, 224), Image.LANCZOS))
    np.testing.assert_array_equal(stretched(image, (224, 224)), expected, strict=True)
    assert np.abs(expected.astype(int) - padded(image, (224, 224))).max() > 100, "the two ways differ"


# examples/openpi_server.py, run as its first lines say.

EXAMPLE = Path(__file__).parents[2] / "examples" / "openpi_server.py"


@pytest.fixture(scope="module")
def port() -> Iterator[int]:
    with subprocess.Popen([sys.executable, EXAMPLE, "0"], stdout=subprocess.PIPE, text=True) as server:
        assert server.stdout is not None
        yield int(server.stdout.readline().split()[-1])
        server.terminate()


def test_it_answers_a_chunk_of_15_of_which_8_are_executed(port: int) -> None:
    executed = joints(talk(f"openpi://127.0.0.1:{port}?profile=pi05-droid", calls=2))
    expected = np.zeros((16, 7))
    expected[:, 5] = np.float32(0.05)
    np.testing.assert_array_equal(executed, expected)


def test_it_tells_its_errors_and_its_health(port: int) -> None:
    with pytest.raises(PolicyError, match=r"KeyError: 'observation/exterior_image_1_left'") as caught:
        talk(f"openpi://127.0.0.1:{port}?profile=pi05-droid&exterior=0")
    assert caught.value.kind == "exception"
    with urllib.request.urlopen(f"http://127.0.0.1:{port}/healthz") as answer:
        assert answer.read() == b"OK\n"


def test_it_needs_no_package_of_carecontact() -> None:
    assert "carecontact" not in [
        line for line in EXAMPLE.read_text().splitlines() if line.startswith(("import", "from"))
    ]
    assert len(EXAMPLE.read_text().splitlines()) < 70


# Spoilt frames at the client of every dialect: none crashes, hangs or slips in; what is well formed is understood.

FRAMES = {"transport": 40, "msgpack": 80, "schema": 80, "dtype": 80, "shape": 80, "value": 80, "well-formed": 60}
"""Of each dialect in the fast suite; the slow one sends ten times as many."""
CONFIG: Plain = {
    "image_resolution": [224, 224],
    "needs_wrist_camera": True,
    "n_external_cameras": 1,
    "needs_stereo_camera": False,
    "needs_session_id": True,
    "action_space": "joint_velocity",
}


def bin_keys(value: Any) -> Any:
    """Arrays as openpi marks them, in place of the native wire's marks."""
    if isinstance(value, list):
        return [bin_keys(inner) for inner in value]
    if not isinstance(value, dict):
        return value
    marked = "__ndarray__" in value and isinstance(value.get("data"), bytes)
    return {key.encode() if marked and isinstance(key, str) else key: bin_keys(v) for key, v in value.items()}


class Peer(test_fuzz.Peer):
    """Of one dialect, in the middle of a trial."""

    def __init__(self, dialect: str) -> None:
        self.dialect, self.unasked = dialect, dialect != "vla-eval"
        super().__init__(self._client)

    def _client(self, connection: Connection) -> Client:
        if self.dialect == "vla-eval":
            client: Client = VlaEvalClient(connection, options={"space": "joint_position"})
            arguments = {"dialect": "vla-eval", "state": "yes"}
            card = PolicyCard(
                name="fuzz",
                action_space="joint_position",
                control="droid",
                cameras=("exterior",),
                out_of_bounds="clip",
                arguments=arguments,
            )
            client._card = card  # pyright: ignore[reportAttributeAccessIssue]
            return client
        options = {"profile": "pi05-droid"} if self.dialect == "openpi" else {}
        client = OpenpiClient(connection, scheme=self.dialect, options=options)
        profile = named_profile(options) if options else announced_profile(CONFIG, {})
        client._profile = profile
        return client

    def replies(self) -> dict[str, Plain]:
        """Well-formed answers by the request that they answer."""
        if self.dialect == "vla-eval":
            seq = self.client._seq + 1  # pyright: ignore[reportAttributeAccessIssue]
            hello = {"protocol_version": 1, "action_spec": {}, "observation_params": {"send_state": True}}
            return {
                "card": {"type": "hello", "payload": hello, "seq": seq, "timestamp": 0.5},
                "act": {
                    "type": "action",
                    "payload": {"actions": actions(1)[0].astype("<f8")},
                    "seq": seq,
                    "timestamp": 0.5,
                },
            }
        timing = {"infer_ms": 4.5}
        known = {"act": {"actions": actions(10).astype("<f8"), "server_timing": timing}}
        return known | ({"card": {}} if self.dialect == "openpi" else {"card": CONFIG, "reset": {"status": "done"}})

    def packer(self) -> Callable[[Any], bytes]:
        return msgpack.packb if self.dialect == "vla-eval" else lambda plain: msgpack.packb(bin_keys(plain))


def harmless(heard: object) -> bool:
    """Whether what got through is something that a good server could have sent."""
    if not isinstance(heard, list):
        return heard is None or isinstance(heard, PolicyCard)
    return 1 <= len(heard) <= 15 and all(
        action.joint is not None
        and action.joint.shape == (7,)
        and np.isfinite(action.joint).all()
        and action.pose_tcp_in_base is action.stiffness is action.gripper is None
        and action.done is False
        for action in heard
    )


@pytest.mark.parametrize("dialect", ["openpi", "roboarena", "vla-eval"])
@pytest.mark.parametrize("times", [1, pytest.param(10, marks=pytest.mark.slow)])
def test_no_frame_crashes_hangs_or_slips_in(
    dialect: str, times: int, monkeypatch: pytest.MonkeyPatch, record_property: Callable[[str, object], None]
) -> None:
    small = {name: camera(name, height=36, width=64) for name in GROUNDS}
    monkeypatch.setattr(test_fuzz, "OBSERVATION", replace(seen(), cameras=small))
    rng = random.Random(f"{dialect} {times}")
    plan = [layer for layer, count in FRAMES.items() for _ in range(count * times)]
    rng.shuffle(plan)
    refused = Counter[str]()
    peer = Peer(dialect)
    for layer in plan:
        one = Peer(dialect) if layer == "transport" else peer
        answers, packer = one.replies(), one.packer()
        kind = rng.choice([kind for kind in answers if answers[kind] or layer in ("msgpack", "transport")])
        message = packer(msgpack.unpackb(pack(answers[kind])))
        if layer == "transport":
            wire = spoilt_transport(message, rng)
        else:
            wire = framed(message if layer == "well-formed" else spoilt(answers[kind], layer, rng, packer=packer))
        heard = one.hear(kind, wire, last=layer == "transport")
        if isinstance(heard, PolicyError):
            assert heard.kind in set(PolicyError.KINDS) - {"timeout"}
            assert str(heard)
            assert layer != "well-formed", heard
            refused[layer] += 1
        else:
            assert harmless(heard), layer
        if one is not peer:
            one.close()
    peer.close()
    shares = {layer: round(refused[layer] / (FRAMES[layer] * times), 2) for layer in LAYERS}
    record_property("share refused", shares)
    # A reply holds much that is not used, such as timings: what is spoilt there passes.
    assert all(share > 0.1 for share in shares.values()), shares


if __name__ == "__main__":
    for name, case in CASES.items():
        Image.fromarray(beside(sent(case))).save(FOLDER / f"{name}.png")

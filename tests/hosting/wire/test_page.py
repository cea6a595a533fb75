"""docs/wire.md against the code: the bytes of its messages, and the names in its tables."""

from __future__ import annotations

import dataclasses
import importlib.util
import re
import sys
from pathlib import Path
from types import ModuleType

import msgpack
import numpy as np
import pytest

from carecontact.contract.action import Action
from carecontact.contract.observation import CameraView, Observation
from carecontact.contract.policy import PolicyCard
from carecontact.hosting.wire import codec
from carecontact.hosting.wire.packing import unpack

ROOT = Path(__file__).parents[3]
PAGE = (ROOT / "docs" / "wire.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def tool() -> ModuleType:
    spec = importlib.util.spec_from_file_location("wire_page", ROOT / "tools" / "wire_page.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


def test_the_bytes_on_the_page_are_those_of_the_code(tool: ModuleType) -> None:
    assert tool.filled(PAGE) == PAGE, "run tools/wire_page.py"
    assert set(re.findall(r"<!-- message: (\w+) -->", PAGE)) == set(tool.messages())


def test_the_dumps_can_be_read_back(tool: ModuleType) -> None:
    for name, dump in re.findall(r"<!-- message: (\w+) -->.*?```text\n(.*?)\n```", PAGE, re.DOTALL):
        data = b"".join(bytes.fromhex(line[6:53]) for line in dump.splitlines())
        assert data == tool.messages()[name]
        assert unpack(data)["type"] == name.removesuffix("_list")


def test_a_plain_list_is_the_same_action(tool: ModuleType) -> None:
    array, plain = (
        codec.decode_actions(unpack(tool.messages()[name])["actions"]) for name in ("actions", "actions_list")
    )
    np.testing.assert_array_equal(array[0].pose_tcp_in_base, plain[0].pose_tcp_in_base)


def test_an_ordinary_msgpack_library_reads_and_writes_them(tool: ModuleType) -> None:
    for data in tool.messages().values():
        assert msgpack.packb(msgpack.unpackb(data)) == data


@pytest.mark.parametrize(
    ("heading", "kinds", "own"),
    [
        ("card", (PolicyCard,), set()),
        ("act", (Observation, CameraView), set()),
        ("actions", (Action,), set()),
    ],
)
def test_every_field_stands_in_its_table(heading: str, kinds: tuple[type, ...], own: set[str]) -> None:
    section = re.split(r"^## ", PAGE, flags=re.MULTILINE)
    (text,) = [part for part in section if part.startswith(f"{heading}\n")]
    rows = {name for row in re.findall(r"^\| (`.*?) \|", text, re.MULTILINE) for name in re.findall(r"`(\w+)`", row)}
    fields = {field.name for kind in kinds for field in dataclasses.fields(kind)}
    assert rows == fields - own

"""tools/perception_table.py: measured rows are kept only for what they were measured with."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

import carecontact
from carecontact.protocols import load_protocol, overridden
from carecontact.recording.perception import JOINTS
from carecontact.regions import STANDARD_REGIONS

TOOLS = Path(__file__).parents[1] / "tools"


@pytest.fixture
def tool(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(TOOLS))
    import perception_table

    return perception_table


def made_rows(seed: int, *, body: str, target_m: float, found_on_wrist: bool = False) -> list[dict[str, Any]]:
    row = {
        "seed": seed, "body": body, "tone": "tan", "region": "", "somebody": True, "sure": 33,
        "error_px": [4.0] * len(JOINTS), "visible": [True] * len(JOINTS), "iou": 0.99,
        "target_m": [[target_m, 0.0, 0.0]] * len(STANDARD_REGIONS),
    }  # fmt: skip
    over = [{**row, "condition": "over", "region": region} for region in STANDARD_REGIONS]
    wrist = {**row, "condition": "wrist", "somebody": found_on_wrist, "sure": 21, "error_px": [229.0] * 2 + [None] * 10}
    return [{**row, "condition": "parked"}, {**row, "condition": "noise"}, wrist, *over]


def test_a_scene_is_measured_anew_when_what_it_was_measured_with_changed(
    tool: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    measured: list[int] = []

    def measure(protocol: Any, seed: int, keypoints: object) -> list[dict[str, Any]]:
        measured.append(seed)
        return made_rows(seed, body=protocol.person.body, target_m=0.01)

    rows = tmp_path / "rows.jsonl"
    # As rows were before they carried a fingerprint.
    rows.write_text("".join(json.dumps(row) + "\n" for row in made_rows(6000, body="man-adult", target_m=0.9)))
    monkeypatch.setattr(tool, "scene_rows", measure)
    monkeypatch.setattr(tool, "Remembering", lambda: None)
    monkeypatch.setattr(sys, "argv", ["perception_table.py", "--seeds", "6000-6001", "--rows", str(rows)])
    tool.main()
    assert measured == [6000, 6001]
    tool.main()
    assert measured == [6000, 6001]
    monkeypatch.setattr(tool, "PACKAGES", ("numpy",))
    tool.main()
    assert measured == [6000, 6001, 6000, 6001]


def test_the_fingerprint_follows_rules_body_and_code(
    tool: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    rules = load_protocol()
    first, seen = tool.fingerprint(rules), Path.read_bytes
    assert tool.fingerprint(rules) == first
    assert tool.fingerprint(overridden(rules, {"person.body": "man-old-heavy"})) != first
    assert tool.fingerprint(rules.model_copy(update={"description": "another"})) != first
    for part in tool.SOURCES:
        source = Path(carecontact.__file__).parent / part
        edited = source if source.is_file() else next(source.rglob("*.py"))
        with monkeypatch.context() as patch:
            patch.setattr(Path, "read_bytes", lambda path, e=edited: seen(path) + b"#" * (path == e))
            assert tool.fingerprint(rules) != first, part


def test_groups_that_miss_a_line_are_named_though_the_pool_holds_it(tool: ModuleType) -> None:
    rows = [row for seed in range(3) for row in made_rows(seed, body="man-adult", target_m=0.008)]
    rows += made_rows(3, body="man-old-heavy", target_m=0.021, found_on_wrist=True)
    text = tool.tables(rows)
    assert "Missed lines: none." in text
    assert "| man-old-heavy | 1 | 4.0 | 0.990 | 21.0 | 21.0 | 21.0 |" in text
    assert "Over 15 mm by themselves: man-old-heavy forearm 21.0, man-old-heavy upper arm 21.0" in text
    assert "From the wrist camera, robot parked: somebody in 1 of 4 scenes, with 21 to 21 landmarks" in text
    assert "229 to 229 px off" in text

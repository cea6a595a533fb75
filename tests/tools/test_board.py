"""The pages of the board, from entries that strangers write."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError
from tools.site.board import ROOT, board_tables, entries, entry_page, rerun

from carecontact.cli.board import BoardEntry, BoardLevel, Passes, Share
from carecontact.cli.parsing import parse
from carecontact.errors import ConfigError

DRAFT = "bathing-wide-v3-draft L2"


def share(n: int) -> Share:
    return Share(n=n, of=189, pc=100 * n / 189, pc_ci95=(0.0, 100.0))


def level(passed: int, **changes: Any) -> BoardLevel:
    passes = Passes(whole=share(passed), scrubs=share(3), others=share(4), harmless=share(5), tasks={"T1": share(6)})
    facts: dict[str, Any] = {"protocol": DRAFT, "protocol_sha256": "0" * 64, "ranked": False, "seeds": "1000-1026"}
    facts |= {"salt_sha256": "", "salt_revealed": False, "passes": passes, "success": share(7), "causes": {}}
    facts |= {"region_correct": share(8), "failures": {"outside_band": 21}, "floor": None, "ceiling": None}
    facts |= {"policy_s": 1.5, "trial_s": None, "recordings_sha256": "a" * 64}
    return BoardLevel.model_validate(facts | changes)


def entry(*levels: BoardLevel, **changes: Any) -> BoardEntry:
    facts: dict[str, Any] = {"name": "My arm", "link": "https://example.org", "method": "served", "policy": "a:B"}
    facts |= {"policy_arguments": {}, "policy_sha256": None, "origin": "served", "receives": [], "trained_on": []}
    return BoardEntry.model_validate(facts | {"release": "1.0", "levels": list(levels)} | changes)


def test_every_entry_of_the_repository_is_one() -> None:
    assert all(each.levels for each in entries().values())


def test_an_empty_board_says_how_to_submit_between_floor_and_ceiling() -> None:
    page = board_tables({})
    assert "No entry yet" in page
    assert page.index("ceiling: oracle") < page.index("floor: ")
    assert "## Draft exam" not in page


def test_a_draft_stands_apart_and_rows_are_ordered() -> None:
    found = {
        "low": entry(level(10)),
        "high": entry(level(90)),
        "frozen": entry(level(50, protocol="bathing-wide-v2 L2", ranked=True)),
    }
    page = board_tables(found)
    assert page.index("## Exam") < page.index("frozen.html") < page.index("## Draft exam") < page.index("high.html")
    assert page.index("high.html") < page.index("low.html")
    assert "of another release" in page, "these entries have other rules than this release"


def test_a_page_has_the_ladder_and_the_failures() -> None:
    page = entry_page("arm", entry(level(63), level(20, protocol="bathing-wide-v2 L3")))
    assert page.count('class="ladder"') == 2
    assert "width:33.3%" in page
    assert "outside band</span></td>" in page
    assert "not ranked" in page


def test_the_command_that_runs_an_entry_again_is_understood_and_quoted() -> None:
    hostile = entry(level(1), policy="a:B; rm -rf x", policy_arguments={"path": "my $HOME"})
    words = shlex.split(rerun("arm", hostile, hostile.levels[0]).replace("\\\n", " "))
    assert "a:B; rm -rf x" in words
    command: Any = parse(words[1:])
    assert (command.seeds, str(command.out)) == ("1000-1026", "runs/arm-again")


@pytest.mark.parametrize(
    "changes",
    [
        {"name": "[x](javascript:1)"},
        {"name": "x {: onclick=alert(1) }"},
        {"link": "javascript:alert(1)"},
        {"policy": "a\n```\n<script>"},
    ],
)
def test_an_entry_cannot_bring_markup(changes: dict[str, str], tmp_path: Path) -> None:
    with pytest.raises(ValidationError):
        entry(level(1), **changes)
    fine = entry(level(1)).model_dump_json()
    (tmp_path / "bad.json").write_text(fine.replace("My arm", "<script>"))
    with pytest.raises(ConfigError, match=r"bad.json is no entry of the board \(name: "):
        entries(tmp_path)


def test_what_a_page_shows_is_escaped() -> None:
    page = entry_page("arm", entry(level(1, failures={"<b>": 1}), receives=["<i>"], release="<u>", policy="<s>"))
    assert not any(tag in page.partition("```")[0] for tag in ("<b>:", "<i>", "<u>", "<s>"))
    assert "&lt;b&gt;" in page


def test_the_intro_of_the_page_is_short() -> None:
    assert len((ROOT / "docs" / "board.md").read_text().split()) <= 300

from __future__ import annotations

import re
from pathlib import Path

import pytest

from carecontact.recording import ARRAYS, SCHEMA_VERSION
from carecontact.scoring import METRICS

PAGE = (Path(__file__).parents[2] / "docs" / "scoring.md").read_text()
ROWS = dict(re.findall(r"^\| `([A-Za-z0-9_]+@\d+)` \| ([^|]+) \|", PAGE, re.MULTILINE))


def test_the_table_lists_every_metric_with_its_unit() -> None:
    assert ROWS == {id_: METRICS[id_].unit for id_ in METRICS}


@pytest.mark.parametrize("group", sorted({path.partition("/")[0] for path in ARRAYS}))
def test_the_layout_lists_every_group(group: str) -> None:
    assert f"`{group}/`" in PAGE


def test_the_page_names_the_schema() -> None:
    assert f"`{SCHEMA_VERSION}`" in PAGE

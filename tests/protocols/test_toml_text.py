from __future__ import annotations

import tomllib
from pathlib import Path

import pytest

from carecontact.protocols import load_protocol, shipped_protocols
from carecontact.protocols.load import merged_table
from carecontact.protocols.toml_text import toml_text


@pytest.mark.parametrize("name", shipped_protocols())
def test_what_is_written_reads_back_as_the_same_table(name: str) -> None:
    table = merged_table(name)
    assert tomllib.loads(toml_text(table)) == table


def test_odd_values_keep_their_type() -> None:
    table = {
        "text": 'quotes " and \\ and \n', "flag": True, "none": [], "wide": "\U0001f916", "of key": 1,
        "deep": {"er": {"x": 1.5}}, "list": [{"id": "a", "in": {"y": [1, 2]}}, {"id": "b"}], "empty": {},
        "mixed": [{"a": 1}, 2],
    }  # fmt: skip
    assert tomllib.loads(toml_text(table)) == table
    assert toml_text(table).count("[[list]]") == 2, "a list of tables has a head for each"


def test_a_file_with_a_base_comes_out_as_the_same_protocol(tmp_path: Path) -> None:
    heir = tmp_path / "mine.toml"
    heir.write_text('base = "bathing-v3-draft"\nid = "mine-v1"\ndescription = "mine"\n[gates.touch]\nduration_s = 3\n')
    whole = tmp_path / "whole.toml"
    whole.write_text(toml_text(merged_table(str(heir))))
    assert load_protocol(str(whole)) == load_protocol(str(heir))

"""Named tissue sets: what ships, what a user's own file must say, and how a protocol takes one."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError

from carecontact.contract.protocol import Tissue
from carecontact.errors import ConfigError, UnknownNameError
from carecontact.protocols import load_protocol
from carecontact.protocols.tissue_sets import load_tissue_set, shipped_tissue_sets

PROTOCOL = load_protocol()
ROW = """
[tissue.forearm]
a_n_m3 = 1.5e6
b_n_m4 = 0.0
c_n_m5 = 1e8
coupling_length_m = 0.0
membrane_n_m = 0.0
damping_ns_m3 = 2e4
areal_mass_kg_m2 = 12.0
contact_n_m3 = 5e7
spacing_m = 0.005
coarse_spacing_m = 0.020
thickness_m = 0.018
measured_depth_m = 0.006
friction = 0.5
source = "calibrated to trials"
"""


def written(folder: Path, text: str) -> str:
    path = folder / "mine.toml"
    path.write_text(text)
    return str(path)


def test_three_sets_ship_and_the_protocol_has_the_papers() -> None:
    assert shipped_tissue_sets() == ["human-published", "manikin-like", "paper-mapping"]
    assert PROTOCOL.person.tissue_set == "paper-mapping"
    assert PROTOCOL.person.tissue == load_tissue_set("paper-mapping").tissue


@pytest.mark.parametrize("name", shipped_tissue_sets())
def test_every_row_tells_its_source_and_measured_range(name: str) -> None:
    rows = load_tissue_set(name).tissue
    assert set(rows) == {"forearm", "upper_arm", "abdomen"}
    for row in rows.values():
        assert len(row.source) > 40
        assert 0.002 < row.measured_depth_m < row.thickness_m
        assert row.spacing_m == 0.005
        assert row.contact_n_m3 == 5e7, "within 2.3e7 to 6.7e7"
        # Three times critical: 2 sqrt(a m) is critical per area.
        assert row.damping_ns_m3 == pytest.approx(6 * (row.a_n_m3 * row.areal_mass_kg_m2) ** 0.5, rel=0.03)


def test_the_papers_upper_arm_reuses_the_forearms_law_and_published_data_give_another() -> None:
    paper, published = (load_tissue_set(name).tissue for name in ("paper-mapping", "human-published"))

    def law(row: object) -> list[float]:
        return [getattr(row, name) for name in ("a_n_m3", "b_n_m4", "c_n_m5", "damping_ns_m3")]

    assert law(paper["upper_arm"]) == law(paper["forearm"])
    assert law(published["upper_arm"]) != law(paper["upper_arm"])
    assert published["forearm"] == paper["forearm"]


def test_hash_is_of_the_rows_alone(tmp_path: Path) -> None:
    first = load_tissue_set(written(tmp_path, f'id = "a"\ndescription = "x"\nbase = "paper-mapping"\n{ROW}'))
    again = load_tissue_set(written(tmp_path, f'# note\nid = "b"\ndescription = "y"\nbase = "paper-mapping"\n{ROW}'))
    other = load_tissue_set(
        written(tmp_path, f'id = "a"\ndescription = "x"\nbase = "paper-mapping"\n{ROW}'.replace("1.5e6", "1.6e6"))
    )
    assert first.sha256 == again.sha256 != other.sha256
    assert first.tissue["abdomen"] == PROTOCOL.person.tissue["abdomen"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (f'id = "mine"\ndescription = "x"\n{ROW}', r"no row for upper_arm, abdomen; add base"),
        (f'id = "mine"\ndescription = "x"\nbase = "none"\n{ROW}', r"base 'none'; valid: human-published"),
        (f'id = "manikin-like"\ndescription = "x"\nbase = "paper-mapping"\n{ROW}', r"is a shipped set's"),
        (ROW, r"id: missing; give it a value"),
        ('id = "mine', r"not TOML"),
        (f'id = "mine"\ndescription = "x"\n{ROW}'.replace("2e4", "-2e4"), r"tissue\.forearm\.damping_ns_m3: .*got -2"),
        (f'id = "mine"\ndescription = "x"\n{ROW}'.replace("1e8", "nan"), r"tissue\.forearm\.c_n_m5: .*finite"),
        ('id = "mine"\ndescription = "x"\n[tissue.knee]\na_n_m3 = 1', r"tissue\.knee"),
    ],
)
def test_a_wrong_file_is_told_with_place(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        load_tissue_set(written(tmp_path, text))


def test_unknown_and_missing_sets_are_told(tmp_path: Path) -> None:
    with pytest.raises(UnknownNameError, match=r"no tissue set named 'skin'; valid: FILE.toml, human-published"):
        load_tissue_set("skin")
    with pytest.raises(ConfigError, match="No such file"):
        load_tissue_set(str(tmp_path / "none.toml"))


def test_the_documents_symbol_table_has_the_shipped_forearm() -> None:
    row = load_tissue_set("paper-mapping").tissue["forearm"]
    lines = (Path(__file__).parents[2] / "docs" / "tissue.md").read_text().splitlines()
    cells = {line.split("|")[2].strip(): line.split("|")[4].strip() for line in lines if line.count("|") == 6}
    said = {name.strip("` "): value for names, value in cells.items() for name in names.split(",")}
    assert float(said["a_n_m3"]) == row.a_n_m3
    assert [float(value) for value in cells["`b_n_m4`, `c_n_m5`"].split(",")] == [row.b_n_m4, row.c_n_m5]
    assert float(said["damping_ns_m3"]) == row.damping_ns_m3
    assert float(said["membrane_n_m"].split()[0]) == row.membrane_n_m


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"measured_depth_m": 0.19}, "no press went into the bone"),
        ({"friction": 50.0}, "less than or equal to 2"),
        ({"source": ""}, "at least 1 character"),
        ({"b_n_m4": -5e8, "c_n_m5": 1e10}, "makes the law soften under load"),
        ({"damping_growth_ns_m4": -1.0}, "greater than or equal to 0"),
    ],
)
def test_a_row_that_no_skin_has_is_refused(change: dict[str, Any], message: str) -> None:
    row = load_tissue_set("paper-mapping").tissue["forearm"]
    with pytest.raises(ValidationError, match=message):
        Tissue.model_validate({**row.model_dump(), **change})

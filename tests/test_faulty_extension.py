"""An installed package that is wrong: who does not use it notices nothing, all others read one line."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from carecontact.cli import main
from carecontact.errors import ConfigError
from carecontact.interface.regions import REGIONS
from carecontact.policies.language.backend import Rules
from carecontact.policies.registry import POLICIES
from carecontact.protocol.gates import ACTIONS
from carecontact.protocol.load import load_protocol
from carecontact.recording import read_recording, write_recording
from carecontact.runs import score_run
from carecontact.scoring import METRICS
from carecontact.scoring.behaviour import BEHAVIOURS
from tests.installed import look_again, write_package
from tests.scoring.synthetic import make_recording, touch

FILES = {
    "faulty_syntax": "def (:\n",
    "faulty_import": "import nothing_of_this_name\n",
    "faulty_hand": "HAND = 'right_hand'\n",
    "faulty_region": "from carecontact.interface.regions import Region\nSHIN = Region(segment='left_shank')\n",
    "faulty_action": ("from carecontact.scoring.actions import Behaviour\nclass Tap(Behaviour): pass\nTAP = Tap\n"),
}
POINTS = {
    "behaviours": {"poor_tap": "faulty_action:TAP", "poor_knock": "faulty_syntax:KNOCK"},
    "regions": {"poor_shin": "faulty_region:SHIN", "poor_hand": "faulty_hand:HAND", "poor_nose": "faulty_import:NOSE"},
    "metrics": {"poor@1": "faulty_action:taps"},
    "policies": {"poor": "faulty_import:TAPPER"},
}
PACKAGE = "of package faulty 0.3"


@pytest.fixture(autouse=True)
def faulty(tmp_path: Path) -> Iterator[None]:
    """The package ``faulty`` is installed, and gone again afterwards."""
    site = tmp_path / "site"
    write_package(site, "faulty", version="0.3", files=FILES, points=POINTS)
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(site)
        look_again(patch, ACTIONS, BEHAVIOURS, REGIONS, METRICS, POLICIES)
        yield


@pytest.mark.parametrize("what", ["tasks", "protocols"])
def test_lists_that_do_not_use_it_are_as_without_it(what: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["list", what]) == 0
    assert "faulty" not in "".join(capsys.readouterr())


@pytest.mark.parametrize(
    ("what", "shipped", "lines"),
    [
        ("actions", "touch", ["'poor_tap' {} (faulty_action:TAP)", "'poor_knock' {} (faulty_syntax:KNOCK) cannot be"]),
        (
            "regions",
            "forearm",
            ["'poor_hand' {} (faulty_hand:HAND) is a str; expected a Region", "'poor_nose' {} "],
        ),
        ("metrics", "C1@1", ["'poor@1' {} (faulty_action:taps) cannot be loaded: "]),
        ("policies", "hover", ["'poor' {} (faulty_import:TAPPER) cannot be loaded: ModuleNotFoundError: No module"]),
    ],
)
def test_a_list_gives_the_fault_in_the_row_of_its_name(
    what: str, shipped: str, lines: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["list", what]) == 0
    printed = capsys.readouterr().out
    assert f"\n{shipped} " in f"\n{printed}"
    for line in lines:
        assert line.format(PACKAGE) in printed


def test_policies_that_follow_words_do_without_its_regions() -> None:
    assert Rules().parse("gently touch the right forearm").region == "forearm"


def test_a_protocol_that_names_it_is_refused_in_one_line(tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    task = "[[tasks]]\nid = 'T1'\nname = 'x'\naction = 'touch'\nregion = '{}'\nprompt = 'x'\n"
    file.write_text("base = 'bathing-v3'\nid = 'mine'\ndescription = 'x'\n" + task.format("poor_shin"))
    with pytest.raises(
        ConfigError, match=rf"^region 'poor_shin' {PACKAGE} \(faulty_region:SHIN\) cannot be loaded: [^\n]*$"
    ):
        load_protocol(str(file))


def test_scores_name_it_and_not_the_data(tmp_path: Path) -> None:
    """Every score holds every metric."""
    write_recording(touch(), tmp_path / "T1-s000.h5")
    assert read_recording(tmp_path / "T1-s000.h5").header.spec.task_id == "T1"
    with pytest.raises(ConfigError, match=rf"^metric 'poor@1' {PACKAGE} .* cannot be loaded: "):
        score_run(tmp_path)


def test_a_recording_of_its_region_is_not_called_damaged(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "T1-s000.h5"
    write_recording(make_recording("T1"), path)
    monkeypatch.setitem(REGIONS._faults, "forearm", "region 'forearm' cannot be loaded")
    with pytest.raises(ConfigError, match=r"^region 'forearm' cannot be loaded$"):
        read_recording(path)

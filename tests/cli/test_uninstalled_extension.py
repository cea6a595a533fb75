"""A run of another package's action, where that package is not installed any more."""

from __future__ import annotations

from pathlib import Path

import pytest

from carecontact.cli import main
from carecontact.contract.protocol import BEHAVIOURS
from carecontact.protocols import load_protocol
from carecontact.recording import Recording, write_recording
from carecontact.regions import REGIONS
from tests.installed import look_again
from tests.scoring.synthetic import hold, make_recording

OUTSIDE = Path(__file__).parents[1] / "extending"


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """A run of ``tests/extending`` that was scored and reported while it was installed."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(OUTSIDE)
        look_again(patch, BEHAVIOURS, REGIONS)
        protocol = load_protocol(str(OUTSIDE / "holding-v1.toml"))
        made = make_recording("T8", protocol=protocol, duration=4.0, normal={"right_hand": hold(4.0, 0.5, 3.5, 4.0)})
        header = made.header.model_copy(update={"versions": {**made.header.versions, "outside": "1.0"}})
        write_recording(Recording(header=header, arrays=made.arrays), tmp_path / "T8-s000.h5")
        assert main(["score", str(tmp_path)]) == 0
        assert main(["report", str(tmp_path)]) == 0
    return tmp_path


@pytest.mark.parametrize("arguments", [[], ["--rescore"]])
def test_a_report_is_refused_and_the_old_one_stays(
    run: Path, arguments: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    before = (run / "report.html").read_bytes()
    assert main(["report", str(run), *arguments]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    for words in ("T8-s000.h5", "no action named 'hold'", "recorded with outside 1.0, not installed here"):
        assert words in line
    assert (run / "report.html").read_bytes() == before


def test_the_scores_stay_and_the_package_is_named(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = (run / "results.json").read_bytes()
    assert main(["score", str(run)]) == 1
    assert "recorded with outside 1.0, not installed here" in capsys.readouterr().out
    assert (run / "results.json").read_bytes() == before

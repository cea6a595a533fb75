"""--segmenter and --weights, on run and look."""

from __future__ import annotations

from pathlib import Path

import pytest

from carecontact.cli import main
from carecontact.cli.groups import VisionGroup
from carecontact.cli.vision import with_vision
from carecontact.contract.protocol import Vision
from carecontact.errors import ConfigError
from carecontact.observation import grounded_sam
from carecontact.protocols import load_protocol
from tests.episode.test_vision import weights, with_sam

__all__ = ["weights"]

RUN = ["run", "--policy", "hover", "--out", "r"]
LOOK = ["look", "--task", "T1"]


@pytest.mark.parametrize("command", [RUN, LOOK])
@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--weights", "w"], "--weights w: only --segmenter grounded-sam takes weights"),
        (["--segmenter", "mediapipe", "--weights", "w"], "--weights w: only --segmenter grounded-sam takes weights"),
        (["--segmenter", "grounded-sam"], "--segmenter grounded-sam: also give --weights DIR"),
        (["--segmenter", "grounded-sam", "--weights", "w"], "--weights w: no such folder; expected one with grounding"),
    ],
)
def test_what_does_not_fit_is_told_before_anything_runs(
    command: list[str], options: list[str], says: str, capsys: pytest.CaptureFixture[str], tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    assert main([*command, *options]) == 2
    assert says in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_a_protocol_that_names_weights_takes_no_others(weights: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(grounded_sam, "GroundedSam", lambda folder: None)
    own = with_vision(load_protocol(), VisionGroup(segmenter="grounded-sam", weights=weights))
    assert own.vision.segmenter == "grounded-sam"
    assert with_vision(own, VisionGroup(segmenter=None, weights=weights)) == own
    assert with_vision(own, VisionGroup(segmenter="mediapipe", weights=None)).vision == Vision()
    other = with_sam("ab" * 32)
    with pytest.raises(ConfigError, match="names abababababab"):
        with_vision(other, VisionGroup(segmenter=None, weights=weights))
    assert with_vision(other, VisionGroup(segmenter="grounded-sam", weights=weights)) == own

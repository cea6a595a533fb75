from __future__ import annotations

import json
from pathlib import Path

import pytest

from carecontact.contract.protocol import Protocol
from carecontact.episode import vision
from carecontact.episode.vision import person_segmenter
from carecontact.errors import ConfigError
from carecontact.observation.weights import MODELS, weights_sha256
from carecontact.protocols import load_protocol, overridden
from carecontact.recording.versions import package_versions

PROTOCOL = load_protocol()


@pytest.fixture
def weights(tmp_path: Path) -> Path:
    for name in MODELS:
        (tmp_path / name).mkdir()
        (tmp_path / name / "config.json").write_text(json.dumps({"model_type": name}))
        (tmp_path / name / "model.safetensors").write_bytes(b"weights")
    return tmp_path


def with_sam(sha256: str) -> Protocol:
    return overridden(PROTOCOL, {"vision.segmenter": "grounded-sam", "vision.weights_sha256": sha256})


def test_the_default_needs_no_segmenter(weights: Path) -> None:
    assert person_segmenter(PROTOCOL, weights) is None


def test_the_weights_are_those_that_the_protocol_names(weights: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    loaded: list[Path] = []
    monkeypatch.setattr(vision, "GroundedSam", loaded.append)
    protocol = with_sam(weights_sha256(weights))
    with pytest.raises(ConfigError, match="names the segmenter grounded-sam, whose --weights are missing"):
        person_segmenter(protocol)
    person_segmenter(protocol, weights)
    assert loaded == [weights]
    (weights / "sam" / "model.safetensors").write_bytes(b"others")
    with pytest.raises(ConfigError, match=r"these weights have sha256 [0-9a-f]{12}, the protocol names [0-9a-f]{12}"):
        person_segmenter(protocol, weights)
    assert loaded == [weights]


def test_a_recording_names_what_the_segmenter_runs_on() -> None:
    assert set(package_versions("grounded-sam")) - set(package_versions()) == {
        "torch", "transformers", "tokenizers", "pillow"
    }  # fmt: skip

from __future__ import annotations

import json
from pathlib import Path

import pytest

from carecontact.errors import ConfigError
from carecontact.observation.weights import MODELS, weights_sha256


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name in MODELS:
        (tmp_path / "w" / name).mkdir(parents=True)
        (tmp_path / "w" / name / "config.json").write_text(json.dumps({"model_type": name}))
        (tmp_path / "w" / name / "model.safetensors").write_bytes(name.encode())
    return tmp_path / "w"


def test_the_hash_is_that_of_names_and_contents(folder: Path) -> None:
    before = weights_sha256(folder)
    moved = folder.rename(folder.with_name("elsewhere"))
    (moved / "sam" / ".gitattributes").write_text("*.safetensors filter=lfs")
    (moved / "README.md").write_text("beside the models")
    assert weights_sha256(moved) == before
    weights = moved / "sam" / "model.safetensors"
    weights.rename(weights.with_name("other.safetensors"))
    renamed = weights_sha256(moved)
    weights.with_name("other.safetensors").write_bytes(b"trained on")
    assert len({before, renamed, weights_sha256(moved)}) == 3


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (lambda w: w.rename(w.with_name("gone")), r"w: no such folder; expected one with grounding-dino/ and sam/"),
        (lambda w: (w / "sam").rename(w / "SAM"), r"w/sam: no such folder; expected a sam model"),
        (lambda w: (w / "sam" / "config.json").unlink(), r"sam/config.json: not there; expected a sam model"),
        (lambda w: (w / "sam" / "config.json").write_text("{"), r"sam/config.json: not JSON"),
        (lambda w: (w / "sam" / "config.json").write_text("[]"), r"expected model_type 'sam', got None"),
        (
            lambda w: (w / "grounding-dino" / "config.json").write_text('{"model_type": "sam"}'),
            r"grounding-dino/config.json: expected model_type 'grounding-dino', got 'sam'",
        ),
        (lambda w: (w / "sam" / "model.safetensors").unlink(), r"w/sam: expected weights in \*.safetensors, got none"),
        (
            lambda w: (w / "sam" / "model.safetensors").rename(w / "sam" / "pytorch_model.bin"),
            r"expected weights in \*.safetensors, got pytorch_model.bin",
        ),
    ],
)
def test_a_folder_that_lacks_something_is_told(folder: Path, spoil, says: str) -> None:
    spoil(folder)
    with pytest.raises(ConfigError, match=says):
        weights_sha256(folder)

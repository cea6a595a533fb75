"""Loading and inference through torch and transformers with tiny random models: make test-grounded-sam. They say
nothing of the published weights, which no test has."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.ndimage import binary_dilation

from carecontact.episode.episode import first_look
from carecontact.errors import ConfigError, DependencyError, ObservationError
from carecontact.interface.policy import PolicyCard
from carecontact.protocol.load import load_protocol
from carecontact.protocol.overrides import overridden
from carecontact.sensing import grounded_sam
from carecontact.sensing.grounded_sam import MODELS, GroundedSam, weights_sha256
from carecontact.sensing.keypoints import PoseEstimator
from carecontact.sensing.segmentation import PERSON_PROBABILITY
from tests.sensing.tiny_models import save_tiny_models

RGB = np.random.default_rng(0).integers(0, 255, (48, 64, 3), np.uint8)


def test_without_the_extra_the_error_says_what_installs_it(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def absent(name: str) -> Any:
        raise ModuleNotFoundError(f"No module named {name!r}")

    monkeypatch.setattr(grounded_sam, "import_module", absent)
    with pytest.raises(DependencyError, match=r"No module named 'torch'\): pip install 'carecontact\[grounded-sam\]'"):
        GroundedSam(tmp_path)


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("weights")
    save_tiny_models(folder)
    return folder


@pytest.fixture
def own(weights: Path, tmp_path: Path) -> Path:
    """A copy to be spoilt."""
    return Path(shutil.copytree(weights, tmp_path / "weights"))


@pytest.mark.torch
def test_the_box_with_the_highest_score_is_outlined(weights: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(grounded_sam, "MIN_SCORE", 0.0)
    segmenter = GroundedSam(weights)
    boxes: list[list[float]] = []
    outline = segmenter._mask
    monkeypatch.setattr(segmenter, "_mask", lambda rgb, box: boxes.append(box) or outline(rgb, box))
    mask = segmenter.person(RGB)
    assert (mask.shape, mask.dtype) == ((48, 64), np.float32)
    assert set(np.unique(mask)) == {0.0, 1.0}
    np.testing.assert_array_equal(mask, GroundedSam(weights).person(RGB))

    given = segmenter._detector_input(images=RGB, text="a person.", return_tensors="pt")
    found = segmenter._detector(**given)
    best = found.logits.sigmoid().amax(-1)[0].argmax()
    u, v, width, height = found.pred_boxes[0, best].tolist()
    expected = [(u - width / 2) * 64, (v - height / 2) * 48, (u + width / 2) * 64, (v + height / 2) * 48]
    np.testing.assert_allclose(boxes[0], expected, rtol=1e-5)
    # The outline depends on the box, so that the box really reaches SAM.
    assert (outline(RGB, [0.0, 0.0, 63.0, 47.0]) != outline(RGB, [1.0, 1.0, 4.0, 4.0])).any()


@pytest.mark.torch
def test_no_person_found_is_an_empty_mask(weights: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(grounded_sam, "MIN_SCORE", 1.0)
    assert not GroundedSam(weights).person(RGB).any()


@pytest.mark.torch
def test_a_mask_of_another_size_is_refused(weights: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(grounded_sam, "MIN_SCORE", 0.0)
    segmenter = GroundedSam(weights)
    monkeypatch.setattr(segmenter._outliner_input.image_processor, "post_process_masks", _small)
    with pytest.raises(ObservationError, match=r"expected a mask of shape \(48, 64\), got \(16, 16\)"):
        segmenter.person(RGB)


def _small(*_: object) -> list[Any]:
    return [import_module("torch").zeros(1, 1, 16, 16, dtype=bool)]


def _truncated(folder: Path) -> None:
    weights = folder / "sam" / "model.safetensors"
    weights.write_bytes(weights.read_bytes()[:-100])


def _incomplete(folder: Path) -> None:
    numpy: Any = import_module("safetensors.numpy")
    tensors = numpy.load_file(folder / "sam" / "model.safetensors")
    del tensors["vision_encoder.pos_embed"]
    numpy.save_file(tensors, folder / "sam" / "model.safetensors", metadata={"format": "pt"})


def _of_another_size(folder: Path) -> None:
    config = folder / "sam" / "config.json"
    config.write_text(config.read_text().replace('"mlp_dim": 32', '"mlp_dim": 48'))


@pytest.mark.torch
@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (_truncated, r"weights/sam: SamModel cannot be loaded: SafetensorError"),
        (_incomplete, r"weights/sam: SamModel lacks 1 weight, the first vision_encoder.pos_embed"),
        (_of_another_size, r"weights/sam: SamModel cannot be loaded: "),
        (
            lambda w: (w / "grounding-dino" / "preprocessor_config.json").unlink(),
            r"weights/grounding-dino: GroundingDinoImageProcessorPil cannot be loaded: OSError",
        ),
        (
            lambda w: [(w / "grounding-dino" / n).unlink() for n in ("vocab.txt", "tokenizer.json")],
            r"weights/grounding-dino: its tokenizer does not know the words 'a person.'",
        ),
        (
            lambda w: (w / "grounding-dino" / "model.safetensors").write_bytes(b"version https://git-lfs"),
            r"weights/grounding-dino: GroundingDinoForObjectDetection cannot be loaded: SafetensorError",
        ),
    ],
)
def test_a_broken_folder_is_named(own: Path, spoil: Callable[[Path], object], says: str) -> None:
    spoil(own)
    with pytest.raises(ConfigError, match=says):
        GroundedSam(own)


@pytest.mark.torch
def test_it_makes_the_masks_of_an_observation(weights: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(grounded_sam, "MIN_SCORE", 0.0)
    protocol = overridden(
        load_protocol("bathing-v3"),
        {"vision.segmenter": "grounded-sam", "vision.weights_sha256": weights_sha256(weights)},
    )
    card = PolicyCard(name="test", modalities=("rgb", "masks"))
    view = first_look(protocol, task_id="T1", seed=0, card=card, weights=weights).cameras["overhead"]
    assert view.rgb is not None
    assert view.masks is not None
    outlined = binary_dilation(GroundedSam(weights).person(view.rgb) > 0, np.ones((11, 11)))
    assert view.masks["human"].any()
    assert not (view.masks["human"] & ~outlined).any()
    default = PoseEstimator().estimate(view.rgb).person > PERSON_PROBABILITY
    assert (default & ~outlined).any(), "the default's mask differs from it"


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
        (lambda w: (w / "sam").rename(w / "SAM"), r"w/sam/config.json: not there; expected a sam model"),
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
def test_a_folder_that_lacks_something_is_refused(folder: Path, spoil, says: str) -> None:
    spoil(folder)
    with pytest.raises(ConfigError, match=says):
        weights_sha256(folder)

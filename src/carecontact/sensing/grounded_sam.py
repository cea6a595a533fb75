"""Grounded SAM: Grounding DINO finds the person by a word, SAM outlines what is in the box. The user brings the
weights."""

from __future__ import annotations

import hashlib
import json
import os
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from carecontact.errors import ConfigError, DependencyError, ObservationError, counted
from carecontact.interface.observation import F32, U8, Bool
from carecontact.protocol.protocol import Protocol
from carecontact.sensing.segmentation import PersonSegmenter

MODELS = ("grounding-dino", "sam")
"""Folders in the user's folder, each named as the ``model_type`` in its config.json."""
PROMPT = "a person."
"""Grounding DINO was trained on lower-case phrases that end with a full stop."""
MIN_SCORE = 0.25
"""Default of transformers' post-processing, for boxes and for words."""


def weights_sha256(folder: Path) -> str:
    """sha256 of the names and contents of all files of both models, wherever the folder lies.

    Raises ConfigError naming the place that has no model, another one, or weights that are not safetensors.
    """
    if not folder.is_dir():
        raise ConfigError(f"{folder}: no such folder; expected one with {' and '.join(f'{m}/' for m in MODELS)}")
    digest = hashlib.sha256()
    for name in MODELS:
        _check_model(folder / name)
        # Hidden files are those of git and of download caches.
        files = [path for path in (folder / name).iterdir() if path.is_file() and not path.name.startswith(".")]
        for path in sorted(files):
            with path.open("rb") as stream:
                content = hashlib.file_digest(stream, "sha256").hexdigest()
            digest.update(f"{name}/{path.name} {content}\n".encode())
    return digest.hexdigest()


def _check_model(folder: Path) -> None:
    config = folder / "config.json"
    try:
        content = json.loads(config.read_bytes())
    except (FileNotFoundError, NotADirectoryError):
        raise ConfigError(f"{config}: not there; expected a {folder.name} model as save_pretrained writes it") from None
    except ValueError as error:
        raise ConfigError(f"{config}: not JSON: {error}") from None
    found = content.get("model_type") if isinstance(content, dict) else None
    if found != folder.name:
        raise ConfigError(f"{config}: expected model_type {folder.name!r}, got {found!r:.80}")
    if not any(folder.glob("*.safetensors")):
        # Others are pickles, which run code when they are read.
        others = sorted(path.name for pattern in ("*.bin", "*.pt", "*.pth") for path in folder.glob(pattern))
        raise ConfigError(f"{folder}: expected weights in *.safetensors, got {', '.join(others) or 'none'}")


class GroundedSam:
    """A ``PersonSegmenter`` on the CPU: the same bits from the same image, weights and packages.

    Loads both models from ``grounding-dino/`` and ``sam/`` in ``folder``, as transformers' ``save_pretrained`` writes
    them; never downloads and never reads a pickle. Raises DependencyError without the extra ``grounded-sam``, and
    ConfigError naming the model that cannot be loaded and why.
    """

    def __init__(self, folder: Path) -> None:
        # transformers reads this variable when it is imported; local_files_only below serves where that was before.
        os.environ["HF_HUB_OFFLINE"] = "1"
        try:
            self._torch: Any = import_module("torch")
            transformers: Any = import_module("transformers")
            import_module("PIL.Image")
        except ImportError as error:
            raise DependencyError(
                f"the segmenter grounded-sam needs torch, transformers and pillow ({error}): "
                "pip install 'carecontact[grounded-sam]'"
            ) from None
        transformers.utils.logging.disable_progress_bar()
        transformers.utils.logging.set_verbosity_error()
        detector, outliner = folder / "grounding-dino", folder / "sam"
        self._detector = _model(transformers.GroundingDinoForObjectDetection, detector)
        # Pillow's resizing by name: with torchvision installed transformers would take that one's, which differs.
        self._detector_input = transformers.GroundingDinoProcessor(
            image_processor=_part(transformers.GroundingDinoImageProcessorPil, detector),
            tokenizer=_tokenizer(transformers.AutoTokenizer, detector),
        )
        self._outliner = _model(transformers.SamModel, outliner)
        self._outliner_input = transformers.SamProcessor(_part(transformers.SamImageProcessorPil, outliner))

    def person(self, rgb: U8) -> F32:
        """(H, W) 1 on the person with the highest score and 0 elsewhere; all 0 where none is found.

        Raises ObservationError if the models' mask is not of the image's size.
        """
        with self._torch.inference_mode():
            box = self._box(rgb)
            mask = np.zeros(rgb.shape[:2], bool) if box is None else self._mask(rgb, box)
        if mask.shape != rgb.shape[:2]:
            raise ObservationError(f"grounded-sam: expected a mask of shape {rgb.shape[:2]}, got {mask.shape}")
        return mask.astype(np.float32)

    def _box(self, rgb: U8) -> list[float] | None:
        """Left, top, right, bottom [px]."""
        given = self._detector_input(images=rgb, text=PROMPT, return_tensors="pt")
        found = self._detector_input.post_process_grounded_object_detection(
            self._detector(**given),
            given["input_ids"],
            threshold=MIN_SCORE,
            text_threshold=MIN_SCORE,
            target_sizes=[rgb.shape[:2]],
        )[0]
        if not len(found["scores"]):
            return None
        return found["boxes"][int(found["scores"].argmax())].tolist()

    def _mask(self, rgb: U8, box: list[float]) -> Bool:
        given = self._outliner_input(images=rgb, input_boxes=[[box]], return_tensors="pt")
        sizes = given.pop("original_sizes"), given.pop("reshaped_input_sizes")
        # The processor makes boxes of 64 bits, the model has 32.
        given["input_boxes"] = given["input_boxes"].to(self._torch.float32)
        # A box leaves no doubt which object is meant, so one mask is requested and not three to choose from.
        found = self._outliner(**given, multimask_output=False)
        masks = self._outliner_input.image_processor.post_process_masks(found.pred_masks, *sizes)
        return masks[0].numpy()[0, 0]


def _model(kind: Any, folder: Path) -> Any:
    model, loaded = _part(kind, folder, use_safetensors=True, output_loading_info=True)
    # transformers would initialise missing weights at random and only warn.
    missing = sorted(loaded["missing_keys"])
    if missing:
        raise ConfigError(f"{folder}: {kind.__name__} lacks {counted(len(missing), 'weight')}, the first {missing[0]}")
    return model.eval()


def _tokenizer(kind: Any, folder: Path) -> Any:
    tokenizer = _part(kind, folder)
    # transformers silently makes an empty tokenizer from a folder that has no vocabulary.
    if tokenizer.unk_token_id in tokenizer(PROMPT)["input_ids"]:
        raise ConfigError(f"{folder}: its tokenizer does not know the words {PROMPT!r}: vocab.txt or tokenizer.json?")
    return tokenizer


def _part(kind: Any, folder: Path, **options: Any) -> Any:
    try:
        return kind.from_pretrained(folder, local_files_only=True, **options)
    except Exception as error:
        # transformers, safetensors and torch each have errors of their own for a file that is absent or broken.
        why = " ".join(str(error).split())
        raise ConfigError(f"{folder}: {kind.__name__} cannot be loaded: {type(error).__name__}: {why:.300}") from None


def person_segmenter(protocol: Protocol, weights: Path | None = None) -> PersonSegmenter | None:
    """Return the protocol's segmenter; None for mediapipe, whose key-point estimator segments as well.

    ``weights``: folder with the weights of any other segmenter.

    Raises ConfigError for weights that are missing, broken or not the protocol's, and DependencyError for a missing
    package.
    """
    wanted = protocol.vision
    if wanted.segmenter == "mediapipe":
        return None
    if weights is None:
        raise ConfigError(f"protocol {protocol.id} names the segmenter {wanted.segmenter}, whose --weights are missing")
    found = weights_sha256(weights)
    if found != wanted.weights_sha256:
        raise ConfigError(
            f"{weights}: these weights have sha256 {found[:12]}, the protocol names {wanted.weights_sha256[:12]}"
        )
    return GroundedSam(weights)

"""Checks a folder with the weights of Grounded-SAM and computes the hash that names it."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

from carecontact.errors import ConfigError

MODELS = ("grounding-dino", "sam")
"""Folders in the user's folder, each named as the ``model_type`` in its config.json."""


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
    if not folder.is_dir():
        raise ConfigError(f"{folder}: no such folder; expected a {folder.name} model as save_pretrained writes it")
    config = folder / "config.json"
    try:
        content = json.loads(config.read_bytes())
    except FileNotFoundError:
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

"""The segmenter that a protocol names, with the weights that the user supplied."""

from __future__ import annotations

import os
from pathlib import Path

from carecontact.contract.protocol import Protocol
from carecontact.errors import ConfigError
from carecontact.observation.grounded_sam import GroundedSam
from carecontact.observation.segmentation import PersonSegmenter
from carecontact.observation.weights import weights_sha256

WEIGHTS = "CARECONTACT_WEIGHTS"
"""Tells a trial's process where the weights are; a recording holds their hash and no place."""


def person_segmenter(protocol: Protocol, weights: Path | None = None) -> PersonSegmenter | None:
    """None for mediapipe, whose key-point estimator segments as well. ``weights``: default, the folder in WEIGHTS.

    Raises ConfigError for no weights, broken ones, or others than the protocol's; DependencyError.
    """
    wanted = protocol.vision
    if wanted.segmenter == "mediapipe":
        return None
    named = str(weights) if weights is not None else os.environ.get(WEIGHTS, "")
    if not named:
        raise ConfigError(f"protocol {protocol.id} names the segmenter {wanted.segmenter}, whose --weights are missing")
    found = weights_sha256(Path(named))
    if found != wanted.weights_sha256:
        raise ConfigError(
            f"{named}: these weights have sha256 {found[:12]}, the protocol names {wanted.weights_sha256[:12]}"
        )
    return GroundedSam(Path(named))

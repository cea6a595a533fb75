"""The segmenter that a protocol names, with the weights that the user supplied."""

from __future__ import annotations

from pathlib import Path

from carecontact.contract.protocol import Protocol
from carecontact.errors import ConfigError
from carecontact.observation.grounded_sam import GroundedSam
from carecontact.observation.segmentation import PersonSegmenter
from carecontact.observation.weights import weights_sha256


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

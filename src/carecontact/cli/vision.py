"""--segmenter and --weights, checked before a run."""

from __future__ import annotations

from carecontact.cli.groups import VisionGroup
from carecontact.contract.protocol import Protocol
from carecontact.errors import ConfigError
from carecontact.protocols import overridden


def with_vision(protocol: Protocol, options: VisionGroup) -> Protocol:
    """Return the protocol with the options' segmenter, if they name one, and load its models once, since every trial
    would fail in the same way.

    Raises ConfigError for weights that nothing uses, that are missing, or that do not load; DependencyError.
    """
    segmenter, weights = options.segmenter, options.weights
    name = segmenter or protocol.vision.segmenter
    if name == "mediapipe":
        if weights is not None:
            raise ConfigError(f"--weights {weights}: only --segmenter grounded-sam takes weights")
        return _replaced(protocol, name, "")
    if weights is None:
        raise ConfigError("--segmenter grounded-sam: also give --weights DIR, a folder with grounding-dino/ and sam/")
    from carecontact.observation.grounded_sam import GroundedSam
    from carecontact.observation.weights import weights_sha256

    try:
        sha256 = weights_sha256(weights)
        GroundedSam(weights)
    except ConfigError as error:
        raise ConfigError(f"--weights {error}") from None
    named = protocol.vision.weights_sha256
    if segmenter is None and sha256 != named:
        raise ConfigError(
            f"--weights {weights}: sha256 {sha256[:12]}, protocol {protocol.name} names {named[:12]}; add "
            "--segmenter grounded-sam to use these weights instead"
        )
    return _replaced(protocol, name, sha256)


def _replaced(protocol: Protocol, segmenter: str, weights_sha256: str) -> Protocol:
    return overridden(protocol, {"vision.segmenter": segmenter, "vision.weights_sha256": weights_sha256})

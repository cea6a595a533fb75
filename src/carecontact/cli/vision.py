"""--segmenter and --weights, checked before a run."""

from __future__ import annotations

from carecontact.cli.groups import VisionGroup
from carecontact.contract.protocol import Protocol, Vision
from carecontact.errors import ConfigError


def chosen_vision(protocol: Protocol, options: VisionGroup) -> Vision:
    """Return the options' segmenter, else the protocol's. Loads its models once, since each trial would fail alike.

    Raises ConfigError for weights that nothing uses, that are missing, or that do not load; DependencyError.
    """
    segmenter, weights = options.segmenter, options.weights
    name = segmenter or protocol.vision.segmenter
    if name == "mediapipe":
        if weights is not None:
            raise ConfigError(f"--weights {weights}: only --segmenter grounded-sam takes weights")
        return Vision()
    if weights is None:
        raise ConfigError("--segmenter grounded-sam: give its --weights DIR, a folder with grounding-dino/ and sam/")
    from carecontact.observation.grounded_sam import GroundedSam
    from carecontact.observation.weights import weights_sha256

    try:
        vision = Vision(segmenter="grounded-sam", weights_sha256=weights_sha256(weights))
        GroundedSam(weights)
    except ConfigError as error:
        raise ConfigError(f"--weights {error}") from None
    if segmenter is None and vision != protocol.vision:
        raise ConfigError(
            f"--weights {weights}: sha256 {vision.weights_sha256[:12]}, protocol {protocol.id} names "
            f"{protocol.vision.weights_sha256[:12]}; --segmenter grounded-sam takes them in place of the protocol's"
        )
    return vision

"""Which model finds the person in an image."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from carecontact.contract.protocol.section import Section


class Vision(Section):
    """The model that makes the masks; by default, it is the one that finds the key points."""

    segmenter: Literal["mediapipe", "grounded-sam"] = "mediapipe"
    weights_sha256: Annotated[str, Field(pattern=r"^([0-9a-f]{64})?$")] = ""
    """Hash of the folder of weights that the user supplied (``observation.weights``); empty for mediapipe, which has
    its own in its wheel."""

"""What the levels of one protocol file share: the persons, each of whom must suit all of them."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from carecontact.contract.protocol.section import Section
from carecontact.contract.protocol.variation import Variation


class Level(Section):
    """The fields of one level that decide whether a person suits it."""

    variation: Variation
    reposition_m: Annotated[float, Field(ge=0, le=0.2)] = 0.0
    """How far the person moves the wrist along the board at most."""

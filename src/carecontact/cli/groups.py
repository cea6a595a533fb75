"""Groups of options that several commands share, as fields of the type ``Annotated[Group, FLAT]``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

if TYPE_CHECKING:
    from carecontact.contract.protocol import Protocol

FLAT = tyro.conf.arg(name="")
"""The options of a group keep their own names, without the name of the field that holds the group."""
Switch = Annotated[bool, tyro.conf.FlagCreatePairsOff]
Folder = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DIR")]


@dataclass(frozen=True, kw_only=True)
class ProtocolGroup:
    protocol: str = "bathing-v1"
    """Id of a shipped protocol (see `carecontact list protocols`) or a .toml file."""


@dataclass(frozen=True, kw_only=True)
class RulesGroup(ProtocolGroup):
    """Which protocol, and which person in place of the protocol's own."""

    body: str | None = None
    """Person in place of the protocol's: a name from `carecontact list bodies` or smplx:FILE.npz?sex=F (or M). Every
    output names this change, and such trials are never pooled with the protocol's own."""

    def load(self) -> Protocol:
        """Raises UnknownNameError, or ConfigError naming file, field and what was expected."""
        from carecontact.protocols import adapted, load_protocol

        return adapted(load_protocol(self.protocol), body=self.body)


@dataclass(frozen=True, kw_only=True)
class PhysicsGroup:
    tissue: str | None = None
    """Tissue in place of the protocol's: a name from `carecontact list tissue` or a .toml file that `carecontact
    calibrate` wrote."""
    fast: Switch = False
    """Use physics steps of 4 ms in place of the protocol's. This is quicker and less exact: use it for development."""


@dataclass(frozen=True, kw_only=True)
class VisionGroup:
    segmenter: Literal["mediapipe", "grounded-sam"] | None = None
    """Model that finds the person in the images, in place of the protocol's own (mediapipe); see docs/perception.md."""
    weights: Path | None = None
    """Folder with the weights of --segmenter grounded-sam. carecontact never downloads weights."""


@dataclass(frozen=True, kw_only=True)
class JobsGroup:
    jobs: int | None = None
    """Number of trials that run at once; default: one per core."""


@dataclass(frozen=True, kw_only=True)
class LanguageGroup:
    language: str | None = None
    """rules-v1, replay:FILE.jsonl or live:MODEL, for policies that use language (see docs/language.md); default: the
    policy's own."""
    record: Path | None = None
    """With a live language model: replay file to which its completions are added."""

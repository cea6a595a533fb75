"""Action spaces: one file each, found by name."""

from carecontact.episode.spaces.space import SPACES, ActionSpace

__all__ = ["SPACES", "ActionSpace"]

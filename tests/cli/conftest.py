"""Fixtures of other rooms that tests of commands use."""

from tests.replaying.conftest import pressed, pressed_file

__all__ = ["pressed", "pressed_file"]

from __future__ import annotations

import struct

import pytest

from carecontact.hosting.isolation import landlock
from carecontact.hosting.isolation.landlock import CREATE_RULESET, RESOLVE_SOCKET, VERSION_FLAG, restrict


@pytest.mark.parametrize(("version", "taken"), [(8, False), (9, True)])
def test_a_right_that_the_kernel_does_not_know_is_not_asked_for(
    version: int, taken: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It would refuse all of it."""
    handled: list[int] = []

    def kernel(number: int, *arguments: object) -> int:
        if number == CREATE_RULESET and arguments[-1] == VERSION_FLAG:
            return version
        attributes = arguments[0]
        assert isinstance(attributes, bytes)
        handled.append(struct.unpack("=QQQ", attributes)[0])
        return -1

    monkeypatch.setattr(landlock, "_call", kernel)
    assert restrict({"/usr": landlock.READ}) == 0
    assert bool(handled[0] & RESOLVE_SOCKET) is taken

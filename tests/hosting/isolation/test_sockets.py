from __future__ import annotations

import socket
from pathlib import Path

import pytest

from carecontact.hosting.isolation import sockets
from carecontact.hosting.isolation.sockets import open_sockets


def test_sockets_of_this_user_at_which_somebody_listens(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    listens, silent, abstract = str(tmp_path / "listens"), str(tmp_path / "silent"), f"\0{tmp_path}"
    made = [socket.socket(socket.AF_UNIX) for _ in range(3)]
    for each, name in zip(made, (listens, silent, abstract), strict=True):
        each.bind(name)
    made[0].listen()
    made[2].listen()
    monkeypatch.setattr(sockets, "version", lambda: 8)
    found = open_sockets()
    monkeypatch.setattr(sockets, "version", lambda: 9)
    closed = open_sockets()
    for each in made:
        each.close()
    assert listens in found
    assert not [path for path in found if path == silent or "\0" in path or path.startswith("@")]
    assert closed == []


def test_those_of_another_user_are_not_among_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sockets, "version", lambda: 8)
    monkeypatch.setattr("os.geteuid", lambda: 12345)
    place = str(tmp_path / "listens")
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(place)
        listener.listen()
        assert place not in open_sockets()
        Path(place).chmod(0o660)
        assert place in open_sockets(), "of a group that this user is in, as Docker's is"

from __future__ import annotations

import pytest

from carecontact.hosting.wall import ImportWall, raise_wall


@pytest.mark.parametrize(
    "name",
    [
        "mujoco",
        "mujoco.mjx",
        *(
            f"carecontact.{part}"
            for part in (
                "world", "sim", "observation", "trials", "recording", "recording.schema", "scoring", "stats", "reports",
                "tasks", "protocols", "cli", "calibration", "contractual",
            )
        ),
    ],
)  # fmt: skip
def test_closed(name: str) -> None:
    with pytest.raises(ImportError, match=f"{name} is closed to policies") as caught:
        ImportWall().find_spec(name, None)
    assert caught.value.name == name


@pytest.mark.parametrize(
    "name",
    ["carecontact", "carecontact.errors", "carecontact.contract.action", "carecontact.policies.hover", "mujocolike"],
)
def test_open(name: str) -> None:
    assert ImportWall().find_spec(name, None) is None


def test_a_wall_raised_too_late_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    import sys

    monkeypatch.setitem(sys.modules, "carecontact.scoring", sys)
    with pytest.raises(RuntimeError, match="loaded before the import restrictions"):
        raise_wall()

"""Protocols that parse and still cannot run."""

from __future__ import annotations

from typing import Any

import pytest

from carecontact.contract.protocol import BEHAVIOURS, Protocol
from carecontact.errors import ConfigError
from carecontact.protocols import load_protocol
from carecontact.registry import Registry
from carecontact.runs.preflight import check_protocol, check_rows
from carecontact.scoring import METRICS
from carecontact.scoring.limits import LIMIT_PACKS


def edited(section: str, **values: Any) -> Protocol:
    content = load_protocol().model_dump()
    content[section] |= values
    return Protocol.model_validate(content)


def test_the_shipped_protocol_can_run() -> None:
    check_protocol(load_protocol())
    check_rows(load_protocol())


@pytest.mark.parametrize(
    ("section", "values", "told"),
    [
        ("person", {"body": "nobody"}, r"no body named 'nobody'; valid: .*man-adult"),
        (
            "scene",
            {"parked_joint_rad": (0, 0, 0, 0, 0, 1, 0)},
            r"joint 4 at 0 is outside the robot's -3.0718 to",
        ),
        ("contact", {"peak_filter_hz": 250.0}, r"contact.peak_filter_hz: 250"),
        ("limits", {"pack": "nonexistent"}, r"limits.pack: no limit pack named 'nonexistent'; valid: .*behrens-2021"),
    ],
)
def test_what_would_fail_every_trial_is_told_before(section: str, values: dict[str, Any], told: str) -> None:
    with pytest.raises(ConfigError, match=told):
        check_protocol(edited(section, **values))


@pytest.mark.parametrize("registry", [METRICS, LIMIT_PACKS, BEHAVIOURS], ids=lambda registry: registry.kind)
def test_a_row_that_cannot_be_loaded_is_told_before(registry: Registry[Any], monkeypatch: pytest.MonkeyPatch) -> None:
    name = next(iter(registry))
    monkeypatch.setattr(registry, "_settled", set())
    monkeypatch.setitem(registry._faults, name, f"{name} cannot be loaded")
    with pytest.raises(ConfigError, match=f"^{name} cannot be loaded$"):
        check_rows(load_protocol())

"""The table ``person.alive`` of a protocol."""

from __future__ import annotations

from pathlib import Path

import pytest

from carecontact.contract.protocol import Alive, Breathing, Protocol, Repositioning
from carecontact.errors import ConfigError
from carecontact.protocols import load_protocol


def loaded(folder: Path, alive: str) -> Protocol:
    file = folder / "mine.toml"
    file.write_text(f'base = "bathing-v3-draft"\nid = "mine"\ndescription = "x"\nfrozen = false\n{alive}')
    return load_protocol(str(file))


def test_what_the_person_does_is_part_of_the_hash() -> None:
    protocol = load_protocol()
    assert protocol.person.alive == Alive()
    moves = protocol.person.model_copy(update={"alive": Alive(manner="holds")})
    assert protocol.model_copy(update={"person": moves}).sha256 != protocol.sha256


def test_an_empty_table_takes_the_published_values(tmp_path: Path) -> None:
    alive = loaded(tmp_path, "[person.alive.breathing]\n[person.alive.repositioning]\n").person.alive
    assert (alive.breathing, alive.repositioning) == (Breathing(), Repositioning())
    assert alive.withdrawal is None
    assert alive.uses_the_arm


@pytest.mark.parametrize(
    ("table", "told"),
    [
        ("[person.alive.breathing]\nfrequency_hz = [0.3, 0.2]", r"breathing\.frequency_hz: expected \[low, high\] Hz"),
        (
            "[person.alive.breathing]\nabdomen_m = [5, 15]",
            r"breathing\.abdomen_m: expected .* 0 to 0\.03, got \[5, 15\]",
        ),
        ("[person.alive.repositioning]\nper_minute = 0", r"repositioning\.per_minute: expected more than 0"),
        ("[person.alive.withdrawal]\nwrist_m = 8", r"withdrawal\.wrist_m: expected at most 0\.15"),
        ('[person.alive]\nmanner = "fights"', r"alive\.manner: expected 'passive', 'helps' or 'holds'"),
        (
            "[person.alive.breathing]\nrate = 1",
            r"no such field in the table person\.alive\.breathing.*valid: frequency_hz",
        ),
    ],
)
def test_a_wrong_value_is_told_with_what_would_be_valid(tmp_path: Path, table: str, told: str) -> None:
    with pytest.raises(ConfigError, match=told):
        loaded(tmp_path, table)

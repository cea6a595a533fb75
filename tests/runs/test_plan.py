"""--tasks and --seeds against the shipped protocol."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from carecontact.errors import ConfigError
from carecontact.protocols import load_protocol
from carecontact.runs.plan import compact, parse_seeds, parse_tasks, plan_trials

PROTOCOL = load_protocol()
ALL = ["T1", "T2", "T3", "T4", "T5", "T6", "T7"]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("T1", ["T1"]),
        ("T2,T1", ["T1", "T2"]),
        ("T1-T7", ALL),
        ("all", ALL),
        ("T3-T5, T1", ["T1", "T3", "T4", "T5"]),
        ("T2-T2,T2", ["T2"]),
    ],
)
def test_tasks(text: str, expected: list[str]) -> None:
    assert parse_tasks(text, protocol=PROTOCOL) == expected


@pytest.mark.parametrize("text", ["T8", "t1", "", "T1,,T2", "T3-T1", "T1-T9", "1-7", "-", "T1-"])
def test_wrong_tasks_list_the_valid_ones(text: str) -> None:
    with pytest.raises(ConfigError, match=r"^tasks.*valid: T1, T2, T3, T4, T5, T6, T7") as caught:
        parse_tasks(text, protocol=PROTOCOL)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "expected"),
    [("3", [3]), ("0-19", list(range(20))), ("7,0,4", [0, 4, 7]), ("all", list(range(20))), ("2-3, 3", [2, 3])],
)
def test_seeds(text: str, expected: list[int]) -> None:
    assert parse_seeds(text, protocol=PROTOCOL) == expected


@pytest.mark.parametrize("text", ["20", "0-20", "5-3", "x", "", "1.5", "-1", "1,", "1-", "0-99999999999"])
def test_wrong_seeds_name_the_protocols_list(text: str) -> None:
    with pytest.raises(ConfigError, match=r"^seeds.*0-19"):
        parse_seeds(text, protocol=PROTOCOL)


def test_plan_is_seed_by_seed_and_carries_the_protocol() -> None:
    specs = plan_trials(protocol=PROTOCOL, policy="hover", tasks=["T1", "T3"], seeds=[4, 5])
    assert [spec.trial_id for spec in specs] == ["T1-s004", "T3-s004", "T1-s005", "T3-s005"]
    assert all(spec.protocol == PROTOCOL and spec.policy == "hover" for spec in specs)


@given(st.sets(st.integers(0, 60), min_size=1))
def test_compact_says_each_number_once(numbers: set[int]) -> None:
    said: list[int] = []
    parts = compact(numbers).split(", ")
    for part in parts:
        low, _, high = part.partition("-")
        said += range(int(low), int(high or low) + 1)
    assert said == sorted(numbers)
    assert len(parts) == sum(number - 1 not in numbers for number in numbers), "each run of numbers is one part"

from __future__ import annotations

import pytest

from carecontact.reports.short_names import LONGEST, short_names


@pytest.mark.parametrize(
    ("title", "name"),
    [
        ("replay", "replay"),
        ("mean-person person=bathing-wide-L2", "mean-person"),
        ("my_package.policy:MyPolicy steps=10", "MyPolicy"),
        ("my-vla at ws://192.0.2.7:8765 steps=10", "my-vla"),
    ],
)
def test_a_short_name_has_no_arguments_module_or_address(title: str, name: str) -> None:
    assert short_names([title]) == {title: name}


def test_policies_that_differ_in_their_arguments_keep_different_names() -> None:
    titles = ["replay donor=a.h5", "hover", "replay donor=b.h5", "replay"]
    assert list(short_names(titles).values()) == ["replay (1)", "hover", "replay (2)", "replay (3)"]


def test_a_long_name_is_cut_and_stays_different() -> None:
    long = "a_very_long_name_of_a_policy"
    names = list(short_names([f"m:{long}One", f"m:{long}Two"]).values())
    assert len(set(names)) == 2
    assert all(len(name) <= LONGEST + len(" (1)") for name in names)

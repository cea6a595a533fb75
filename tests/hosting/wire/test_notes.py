"""What a policy wants to be kept travels with its actions, and with its failure."""

from __future__ import annotations

import numpy as np
import pytest

from carecontact.errors import PolicyError
from carecontact.hosting.process import PolicyProcess
from tests.hosting.conftest import Launch
from tests.policies.synthetic import SESSION, synthetic_observation


def act(process: PolicyProcess):
    process.start()
    process.reset("touch", SESSION)
    return process.act(synthetic_observation())


def test_notes_come_with_the_actions(launch: Launch) -> None:
    process = launch(
        """
        class P(Base):
            def take_notes(self):
                return {"chosen": 3, "map": np.eye(3, dtype=np.float32), "options": [{"depth_m": 0.012}]}
        """
    )
    notes = act(process).notes
    assert (notes["chosen"], notes["options"]) == (3, [{"depth_m": 0.012}])
    np.testing.assert_array_equal(notes["map"], np.eye(3, dtype=np.float32))


def test_a_policy_without_notes_has_none(launch: Launch) -> None:
    assert act(launch("class P(Base): pass")).notes == {}


@pytest.mark.parametrize(("error", "kind"), [("LanguageError", "language"), ("ProgramError", "program")])
def test_a_failure_of_language_is_told_without_traceback_and_with_notes(launch: Launch, error: str, kind: str) -> None:
    process = launch(
        f"""
        from carecontact.errors import {error}
        class P(Base):
            def act(self, observation):
                raise {error}("the endpoint sleeps")
            def take_notes(self):
                return {{"asked": 1}}
        """
    )
    with pytest.raises(PolicyError, match="failed at act: the endpoint sleeps") as caught:
        act(process)
    assert caught.value.kind == kind
    assert "Traceback" not in str(caught.value)
    assert caught.value.notes == {"asked": 1}


@pytest.mark.parametrize("notes", ["1 / 0", "{'a': object()}", "{'a': np.zeros(5_000_000)}"])
def test_notes_that_fail_do_not_hide_the_failure(launch: Launch, notes: str) -> None:
    process = launch(
        f"""
        from carecontact.errors import LanguageError
        class P(Base):
            def act(self, observation):
                raise LanguageError("the endpoint sleeps")
            def take_notes(self):
                return {notes}
        """
    )
    with pytest.raises(PolicyError, match="the endpoint sleeps") as caught:
        act(process)
    assert (caught.value.kind, caught.value.notes) == ("language", {})


@pytest.mark.parametrize(
    ("notes", "kind"),
    [("{'a': object()}", "exception"), ("{'../up': 1}", "garbage"), ("[1]", "garbage"),
     ("{'a': np.zeros(5_000_000)}", "oversize")],
)  # fmt: skip
def test_bad_notes_are_the_policys_failure(launch: Launch, notes: str, kind: str) -> None:
    process = launch(f"class P(Base):\n            def take_notes(self):\n                return {notes}")
    with pytest.raises(PolicyError) as caught:
        act(process)
    assert caught.value.kind == kind

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from carecontact.protocols import load_protocol
from carecontact.recording import SEGMENTS, Recording
from carecontact.reports.limit_rows import limit_rows
from carecontact.scoring import METRICS, score_recording
from carecontact.scoring.contact import find_contact
from carecontact.scoring.limits import LIMIT_PACKS, UNCHECKED, LimitPack, footnote
from tests.scoring.synthetic import hold, make_recording, touch

FAST = settings(max_examples=15, deadline=None)


def utilisation(pack: str, recording: Recording) -> float | None:
    return METRICS[f"{pack}_utilisation@1"].compute(find_contact(recording))


@pytest.mark.parametrize("pack", [LIMIT_PACKS[name] for name in LIMIT_PACKS], ids=list(LIMIT_PACKS))
def test_every_pack_has_provenance_and_a_limit_for_every_segment(pack: LimitPack) -> None:
    assert LIMIT_PACKS[pack.id] is pack
    assert pack.title
    assert pack.source
    assert all(pack.limit(segment) > 0 for segment in SEGMENTS)
    assert pack.limit("something else") == min(pack.limits.values())


def test_the_protocols_pack_is_the_registered_one() -> None:
    limits = load_protocol().limits
    assert dict(LIMIT_PACKS[limits.pack].limits) == limits.f_pain_n


def test_the_iso_pack_says_that_it_is_to_be_checked() -> None:
    pack = LIMIT_PACKS["iso-ts-15066-2016"]
    assert pack.status == "to be checked"
    titles = [pack.title, METRICS["iso_utilisation@1"].title, METRICS["pressure_utilisation@2"].title]
    assert [title.count(UNCHECKED) for title in titles] == [1, 1, 1]
    assert footnote(titles).startswith(f"{UNCHECKED} from secondary sources")
    assert footnote(["Peak force"]) == ""
    assert pack.limit("right_forearm") == pack.limit("left_forearm") == 160.0
    assert pack.limit("abdomen") == 110.0


def test_the_pressure_pack_is_in_pascals_and_in_no_table_of_forces() -> None:
    assert LIMIT_PACKS["iso-ts-15066-2016-pressure"].unit == "Pa"
    assert {pack.unit for name, pack in LIMIT_PACKS.items() if "pressure" not in name} == {"N"}
    shown = " ".join(row.name for row in limit_rows([score_recording(touch())], gamma=0.35))
    assert "Quasi-static force" in shown
    assert "pressure" not in shown


def test_utilisation_is_the_peak_over_the_limit_of_the_worst_segment() -> None:
    """20 N on the forearm is 0.2 of its pain limit, 15 N on the abdomen 0.25 of its own."""
    both = {"right_forearm": hold(3.0, 1.0, 2.0, 20.0), "abdomen": hold(3.0, 1.0, 2.0, 15.0)}
    recording = make_recording(normal=both)
    assert utilisation("pain", recording) == pytest.approx(0.25)
    assert utilisation("iso", recording) == pytest.approx(15 / 110)


def test_a_knock_too_brief_to_be_a_contact_counts() -> None:
    knock = make_recording(normal={"right_forearm": hold(3.0, 2.98, 3.0, 120.0)})
    assert not find_contact(knock).valid
    assert utilisation("pain", knock) == pytest.approx(1.2)


@FAST
@given(force=st.floats(1, 150))
def test_pain_utilisation_and_the_safety_gate_agree(force: float) -> None:
    score = score_recording(touch(force=force))
    used = score.additional["pain_utilisation@1"]
    assert used is not None
    assert score.safety_gated == (used <= score_gamma())
    assert bool(score.over_limit) == (used > score_gamma())


def score_gamma() -> float:
    return load_protocol().limits.gamma

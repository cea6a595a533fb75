from __future__ import annotations

import pytest

from carecontact.errors import ConfigError
from carecontact.reports.compare.baselines import beside_baselines
from carecontact.reports.compare.blind_floor import blind_floor
from carecontact.reports.compare.overview import overview
from carecontact.runs import RunScores
from carecontact.scoring import TrialScore
from tests.reports.compare.test_baselines import METHOD, passed
from tests.reports.synthetic_run import make_score

REPLAY = passed("replay", "T1", [True] * 2 + [False] * 8) + passed("replay", "T6", [True] * 5 + [False] * 5)
MEAN = passed("mean-person", "T1", [True] * 4 + [False] * 6) + passed("mean-person", "T6", [False] * 10)
ORACLE = [s.model_copy(update={"privileged": True}) for s in passed("oracle", "T1", [True] * 10)]


def test_each_place_has_its_own_best_blind_arm() -> None:
    floor = blind_floor([REPLAY, MEAN, passed("state-machine", "T1", [True] * 10), ORACLE], METHOD.scores[0])
    found = {place: (best.policy, best.rate.k, best.rate.n) for place, best in floor.items()}
    assert found == {"all": ("replay", 7, 20), "T1": ("mean-person", 4, 10), "T6": ("replay", 5, 10)}


def test_other_rules_have_a_floor_of_their_own() -> None:
    """A level, an override or another protocol: its hash or its overrides differ."""
    other = [s.model_copy(update={"protocol_sha256": "1" * 64}) for s in REPLAY]
    assert blind_floor([other], METHOD.scores[0]) == {}
    assert blind_floor([other], other[0])["all"].policy == "replay"


def test_a_probe_and_a_ceiling_stand_beside_the_floor_and_are_not_it() -> None:
    probe = passed("feint-and-wait", "T1", [True] * 9 + [False])
    beside = beside_baselines(METHOD, [RunScores(scores=scores) for scores in (REPLAY, MEAN, probe, ORACLE)])
    assert [row.role for row in beside.baselines] == ["blind", "blind", "probe", "privileged"]
    assert {place: best.policy for place, best in beside.floor.items()} == {
        "all": "replay", "T1": "mean-person", "T6": "replay",
    }  # fmt: skip


def test_a_baseline_of_somebody_else_is_floor_and_not_called_blind() -> None:
    """Nobody registered it, so that nothing but its name under --baseline says what it is."""
    own = RunScores(scores=passed("my:Blind", "T1", [True] * 9 + [False]))
    beside = beside_baselines(METHOD, [own, RunScores(scores=REPLAY)])
    assert [row.role for row in beside.baselines] == ["method", "blind"]
    assert {place: (best.policy, best.blind) for place, best in beside.floor.items()} == {
        "all": ("my:Blind", False), "T1": ("my:Blind", False), "T6": ("replay", True),
    }  # fmt: skip
    assert not beside.only_blind


def test_a_registered_method_is_a_floor_only_where_nothing_is_blind_and_never_called_blind() -> None:
    method = RunScores(scores=passed("state-machine", "T1", [True] * 10))
    alone = beside_baselines(METHOD, [method])
    assert (alone.floor["all"].policy, alone.floor["all"].blind, alone.only_blind) == ("state-machine", False, False)
    beside = beside_baselines(METHOD, [method, RunScores(scores=REPLAY)])
    assert {best.policy for best in beside.floor.values()} == {"replay"}


@pytest.mark.parametrize(
    ("scores", "what"),
    [
        ([make_score("T1", k, policy="replay") for k in range(2)], "replay, which is a blind baseline"),
        ([make_score("T1", k, policy="feint-and-wait") for k in range(2)], "feint-and-wait, which is a probe"),
        (
            [make_score("T1", k, policy="x").model_copy(update={"privileged": True}) for k in range(2)],
            "x, .* privileged",
        ),
    ],
)
def test_only_methods_are_ranked(scores: list[TrialScore], what: str) -> None:
    methods = [RunScores(scores=[make_score("T1", k, policy=name) for k in range(2)]) for name in ("a", "b")]
    overview([*methods, RunScores(scores=[make_score("T1", k, policy="c") for k in range(2)])])
    with pytest.raises(ConfigError, match=f"C is {what}"):
        overview([*methods, RunScores(scores=scores)])

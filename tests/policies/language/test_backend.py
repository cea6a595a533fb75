from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from carecontact.errors import ContractError, LanguageError
from carecontact.interface.regions import REGIONS, STANDARD_REGIONS
from carecontact.policies.language.backend import ACTIONS, MANNERS, Intent, LanguageModel, Option, Rules
from carecontact.policies.language.completion import Completion, CompletionRequest, Replay, Transcript
from carecontact.protocol.load import load_protocol


@pytest.mark.parametrize(
    ("instruction", "expected"),
    [
        ("gently touch the right forearm", ("touch", "forearm", "right", "gentle")),
        ("push the right forearm", ("push", "forearm", "right", "none")),
        ("Wash the RIGHT lower arm.", ("scrub", "forearm", "right", "none")),
        ("please wipe the left upper-arm firmly", ("scrub", "upper_arm", "left", "firm")),
        ("rest your hand on the belly, softly", ("touch", "abdomen", "none", "gentle")),
        ("push  aside the right\tforearm", ("push", "forearm", "right", "none")),
    ],
)
def test_known_instructions(instruction: str, expected: tuple[str, str, str, str]) -> None:
    intent = Rules().parse(instruction)
    assert (intent.action, intent.region, intent.side, intent.manner) == expected


def test_every_prompt_of_the_protocol_means_its_task() -> None:
    for task in load_protocol("bathing-v3").tasks:
        intent = Rules().parse(task.prompt)
        assert (intent.action, intent.region) == (task.action, task.region)
        assert intent.side == ("none" if task.region == "abdomen" else "right")


@given(
    action=st.sampled_from([(a, w) for a, words in ACTIONS.items() for w in words]),
    region=st.sampled_from([(r, w) for r in STANDARD_REGIONS for w in REGIONS[r].words]),
    manner=st.sampled_from([("none", ""), *((m, w) for m, words in MANNERS.items() for w in words)]),
)
def test_every_synonym_is_understood(action: tuple[str, str], region: tuple[str, str], manner: tuple[str, str]) -> None:
    side = "" if region[0] == "abdomen" else "left"
    intent = Rules().parse(f"{manner[1]} {action[1]} the {side} {region[1]}")
    assert (intent.action, intent.region, intent.manner) == (action[0], region[0], manner[0])


@pytest.mark.parametrize(
    ("instruction", "word"),
    [
        ("touch the forearm", "which forearm"),
        ("touch the right arm", "no region"),
        ("caress the right forearm", "no action"),
        ("touch and scrub the right forearm", "more than one action"),
        ("touch the abdomen and the right forearm", "more than one region"),
        ("touch the right or left forearm", "more than one side"),
        ("gently but firmly scrub the abdomen", "more than one manner"),
        ("do not touch the right forearm", "negation"),
        ("don’t touch the abdomen", "negation"),
        ("touch the right abdomen", "no right side"),
        ("", "no action"),
    ],
)
def test_refuses_what_is_ambiguous(instruction: str, word: str) -> None:
    with pytest.raises(LanguageError, match=word):
        Rules().parse(instruction)


def intent(action: str = "touch", manner: str = "none") -> Intent:
    return Intent.model_validate({"action": action, "region": "forearm", "side": "right", "manner": manner})


def option(**changes: object) -> Option:
    base = {"primitive": "touch", "approach": "above", "key_point": 0.5, "depth_m": 0.015, "speed_m_s": 0.04}
    return Option(**{**base, **changes})  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize(("manner", "depth"), [("gentle", 0.010), ("none", 0.015), ("firm", 0.020)])
def test_manner_picks_the_depth(manner: str, depth: float) -> None:
    options = [option(depth_m=d) for d in (0.020, 0.010, 0.015)]
    assert options[Rules().choose(intent(manner=manner), options)].depth_m == depth


def test_push_takes_the_longest_lever_on_the_near_side() -> None:
    options = [
        option(),
        option(primitive="push", approach="far_side", key_point=0.9),
        option(primitive="push", approach="near_side", key_point=0.5),
        option(primitive="push", approach="near_side", key_point=0.7),
    ]
    assert Rules().choose(intent("push"), options) == 3


def test_the_middle_wins_and_ties_go_to_the_first() -> None:
    options = [option(key_point=0.2), option(key_point=0.5), option(key_point=0.5)]
    assert Rules().choose(intent(), options) == 1


def test_no_fitting_option_is_an_error() -> None:
    with pytest.raises(ContractError, match="none of 1 options is a scrub"):
        Rules().choose(intent("scrub"), [option()])


OPTIONS = [
    Option(primitive="touch", approach="above", key_point=k, depth_m=0.012, speed_m_s=0.03) for k in (0.35, 0.5, 0.65)
]
INTENT = Intent(action="touch", region="forearm", side="right", manner="gentle")
READ = {"action": "scrub", "region": "forearm", "side": "right", "manner": "gentle", "unclear": ""}


class Says:
    """A source of completions that says what it is given, in turn."""

    name, model = "live:m-1", "m-1"

    def __init__(self, *answers: str | Completion) -> None:
        self.answers, self.asked = list(answers), list[CompletionRequest]()

    def complete(self, request: CompletionRequest) -> Completion:
        self.asked.append(request)
        answer = self.answers.pop(0)
        return answer if isinstance(answer, Completion) else Completion(text=answer, model="m-1-exact")


def model(*answers: str | Completion, record: Path | None = None) -> tuple[LanguageModel, Says]:
    source = Says(*answers)
    return LanguageModel(Transcript(source, record=record)), source


def test_reads_an_instruction() -> None:
    backend, source = model(json.dumps(READ))
    assert backend.parse("gently scrub the right forearm") == Intent(
        action="scrub", region="forearm", side="right", manner="gentle"
    )
    assert backend.name == "live:m-1"
    (asked,) = source.asked
    assert asked.messages[-1].content == "gently scrub the right forearm"
    schema: dict[str, Any] = asked.json_schema or {}
    assert schema["additionalProperties"] is False
    assert set(schema["required"]) == set(READ)
    assert schema["properties"]["action"]["enum"] == ["touch", "push", "scrub"]


@pytest.mark.parametrize(
    ("changed", "fault"),
    [
        ({"unclear": "which arm?"}, "finds it unclear: which arm"),
        ({"side": "none"}, "side none for the forearm; valid: right or left"),
        ({"region": "abdomen"}, "side right for the abdomen; valid: none"),
    ],
)
def test_an_unclear_instruction_is_refused(changed: dict[str, str], fault: str) -> None:
    with pytest.raises(LanguageError, match=fault):
        model(json.dumps(READ | changed))[0].parse("scrub the forearm")


@pytest.mark.parametrize("fenced", ["Here it is:\n```json\n{}\n```\n", "```{}```", "```json {} ``` Good luck!"])
def test_an_answer_between_fences_is_taken(fenced: str) -> None:
    backend, source = model(fenced.replace("{}", json.dumps(READ | {"unclear": ""})))
    assert backend.parse("gently scrub the right forearm").action == "scrub"
    assert len(source.asked) == 1


def test_a_wrong_number_is_reported_in_few_words() -> None:
    backend, _ = model(*['{"number": 999, "reason": ""}'] * 2)
    with pytest.raises(LanguageError, match=r"number: .*expected a whole number from 0 to 299, got 999") as raised:
        backend.choose(INTENT, OPTIONS * 100)
    assert len(str(raised.value)) < 300


def test_selects_by_a_closed_schema() -> None:
    backend, source = model('{"number": 2, "reason": "far from the elbow"}')
    assert backend.choose(INTENT, OPTIONS) == 2
    schema: dict[str, Any] = source.asked[0].json_schema or {}
    assert schema["properties"]["number"]["enum"] == [0, 1, 2]
    assert source.asked[0].messages[-1].content.count('"primitive": "touch"') == 3


@pytest.mark.parametrize(
    "wrong",
    [
        *(f'{{"number": {n}, "reason": ""}}' for n in ("3", "-1", "true", "1.0")),
        '{"number": "2"}',
        '{"number": 1}',
        "2",
        "",
        "none",
    ],
)
def test_a_wrong_answer_is_repaired_once(wrong: str) -> None:
    backend, source = model(wrong, '{"number": 1, "reason": ""}')
    assert backend.choose(INTENT, OPTIONS) == 1
    assert [m.role for m in source.asked[1].messages] == ["system", "user", "assistant", "user"]
    assert source.asked[1].messages[2].content == wrong
    backend, source = model(wrong, wrong)
    with pytest.raises(LanguageError, match="does not fit its schema after 1 repair"):
        backend.choose(INTENT, OPTIONS)
    assert len(source.asked) == 2


def test_a_refusal_is_final() -> None:
    backend, source = model(Completion(text="", refusal="I cannot touch people", model="m"))
    with pytest.raises(LanguageError, match="is a refusal: I cannot touch people"):
        backend.choose(INTENT, OPTIONS)
    assert len(source.asked) == 1


def test_every_answer_is_accounted_for() -> None:
    backend, source = model("", json.dumps(READ), '{"number": 0, "reason": ""}')
    backend.parse("x")
    backend.choose(INTENT, OPTIONS)
    calls = backend.take_calls()
    assert [c["purpose"] for c in calls] == ["parse", "parse", "choose"]
    assert {(c["model"], c["backend"]) for c in calls} == {("m-1-exact", "live:m-1")}
    assert [c["request_sha256"] for c in calls] == [request.sha256 for request in source.asked]
    assert calls[0]["completion_sha256"] == Completion(text="", model="any").sha256
    assert backend.take_calls() == []


def test_a_recording_replays_to_the_same_end(tmp_path: Path) -> None:
    record = tmp_path / "answers.jsonl"
    backend, _ = model("wrong", '{"number": 1, "reason": ""}', record=record)
    backend.choose(INTENT, OPTIONS)
    replayed = LanguageModel(Transcript(Replay(record)))
    assert replayed.choose(INTENT, OPTIONS) == 1
    with pytest.raises(LanguageError, match="has no completion"):
        replayed.choose(INTENT, OPTIONS[:2])


def test_a_text_that_was_cut_is_no_text() -> None:
    source = Says(Completion(text="half a", finish_reason="length", model="m"), "whole")
    transcript = Transcript(source)
    with pytest.raises(LanguageError, match=r"not whole \(finish reason length\)"):
        transcript.text([], purpose="a program", prompt_version="p")
    assert transcript.text([], purpose="a program", prompt_version="p") == "whole"


def test_who_was_asked_is_accounted_for() -> None:
    given = {"endpoint": "models.example", "sent": {"max_tokens": 1024}}
    backend, source = model(Completion(text=json.dumps(READ), model="m-1-exact", **given))
    backend.parse("x")
    source.complete = fails = Fails()
    with pytest.raises(LanguageError):
        backend.parse("y")
    first, second = backend.take_calls()
    assert {k: first[k] for k in ("model", *given)} == {"model": "m-1-exact", **given}
    assert (second["endpoint"], second["completion_sha256"]) == ("models.example", None)
    fails.endpoint = None
    with pytest.raises(LanguageError):
        backend.parse("y")
    assert backend.take_calls() == []


class Fails:
    endpoint: str | None = "models.example"

    def __call__(self, request: CompletionRequest) -> Completion:
        raise LanguageError("no", endpoint=self.endpoint)


def test_what_an_answer_calls_its_fields_is_cut() -> None:
    wrong = json.dumps({"number": 1, "reason": "", "x\x1b" * 2000: 1})
    backend, source = model(wrong, wrong)
    with pytest.raises(LanguageError, match=r"after 1 repair: x\\x1bx") as raised:
        backend.choose(INTENT, OPTIONS)
    assert len(str(raised.value)) < 300
    assert len(source.asked[1].messages[-1].content) < 300

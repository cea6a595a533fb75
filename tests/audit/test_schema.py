"""The schema part on the dialects: clean conversations pass, and what is planted in any of their messages is named."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from carecontact.audit.run import audit_derivation
from carecontact.audit.schema import FIELDS_OF, audit_schema, check_conversation, check_message, failed_at
from carecontact.audit.watched import Keyframe, Watched, watch
from carecontact.interface.observation import MODALITIES, CameraView
from carecontact.interface.policy import PolicyCard
from carecontact.protocol.protocol import TrialSpec
from carecontact.sensing.builder import ALLOWED_IN_VIEW
from carecontact.serving import codec, openpi, vla_eval
from carecontact.serving.packing import pack, unpack
from carecontact.serving.sent_message import rebuilt_message, unpacked_message
from tests.audit.conftest import places
from tests.audit.test_planted_leaks import short
from tests.policies.synthetic import SESSION, synthetic_observation, synthetic_view
from tests.serving.delta_servers import Bridge, Libero, OnOpenpi, OnVlaEval
from tests.serving.fakes import INSTRUCTION, Fake, Openpi, RoboArena, VlaEval, policy_at, seen

SERVERS: dict[str, tuple[Callable[[], Fake], str]] = {
    "openpi": (Openpi, "openpi://127.0.0.1:{}?profile=pi05-droid"),
    "roboarena": (RoboArena, "roboarena://127.0.0.1:{}"),
    "vla-eval": (VlaEval, "vla-eval://127.0.0.1:{}"),
}
DELTAS: dict[str, tuple[Callable[[], Fake], str]] = {
    "openpi, libero": (lambda: OnOpenpi(driver=Libero()), "openpi://127.0.0.1:{}?profile=libero"),
    "openpi, bridge": (lambda: OnOpenpi(driver=Bridge()), "openpi://127.0.0.1:{}?profile=bridge"),
    "vla-eval, libero": (lambda: OnVlaEval(driver=Libero()), "vla-eval://127.0.0.1:{}?profile=libero"),
    "vla-eval, bridge": (
        lambda: OnVlaEval(driver=Bridge(), payload={"observation_params": {"send_state": True}}),
        "vla-eval://127.0.0.1:{}?profile=bridge&orientation=turned",
    ),
}


def conversation(dialect: str) -> tuple[list[bytes], PolicyCard]:
    """Everything that a client sent in a short trial."""
    make, address = (SERVERS | DELTAS)[dialect]
    sent: list[bytes] = []
    with make().running() as port, policy_at(address.format(port)) as policy:
        policy.on_sent = sent.append
        card = policy.start()
        policy.reset(INSTRUCTION, SESSION)
        for _ in range(2):
            policy.act(seen())
        policy.close()
    return sent, card


def dialect_places(dialect: str) -> set[str]:
    sent, card = conversation(dialect)
    return {place for place, _ in check_conversation(sent, card, instruction=INSTRUCTION)}


@pytest.mark.parametrize("dialect", SERVERS)
def test_an_honest_conversation_passes(dialect: str) -> None:
    sent, card = conversation(dialect)
    assert len(sent) == {"openpi": 2, "roboarena": 4, "vla-eval": 5}[dialect]
    assert check_conversation(sent, card, instruction=INSTRUCTION) == []
    assert card.arguments["dialect"] == dialect


@pytest.mark.parametrize("dialect", SERVERS)
def test_each_observation_can_be_made_again_byte_by_byte(dialect: str) -> None:
    sent, card = conversation(dialect)
    carry = [message for message in sent if b"exo" in message or b"exterior" in message]
    assert len(carry) == 2
    for message in carry:
        assert rebuilt_message(seen(), card.arguments, card.cameras, sent=message) == message
    assert unpacked_message(carry[0], dialect)


@pytest.mark.parametrize("name", DELTAS)
def test_conversations_of_servers_that_answer_deltas(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    sent, card = conversation(name)
    assert check_conversation(sent, card, instruction=INSTRUCTION) == []
    carry = [message for message in sent if b"image" in message]
    assert len(carry) == 2
    for message in carry:
        assert rebuilt_message(seen(), card.arguments, card.cameras, sent=message) == message
    # A state with one number more, and a picture that nobody asked for, are named.
    dialect = name.partition(",")[0]
    entries = cast(dict[str, Any], unpacked_message(carry[0], dialect))
    inner = entries if dialect == "openpi" else entries["payload"]
    state = "observation/state" if dialect == "openpi" else "states"
    inner[state] = np.append(inner[state], 3.0)
    inner["seed"] = 3
    changed = openpi.pack(entries) if dialect == "openpi" else pack(entries)
    messages = [changed if message is carry[0] else message for message in sent]
    found = {place for place, _ in check_conversation(messages, card, instruction=INSTRUCTION)}
    assert {place.rpartition(".")[2] for place in found} == {state, "seed"}


def also(function: Callable[..., dict[str, Any]], change: Callable[[dict[str, Any]], object]) -> Callable[..., Any]:
    """``function`` with something planted in what it returns."""

    def leaky(*args: Any, **options: Any) -> dict[str, Any]:
        made = dict(function(*args, **options))
        change(made)
        return made

    return leaky


@pytest.mark.parametrize("dialect", ["openpi", "roboarena"])
@pytest.mark.parametrize(
    ("change", "place"),
    [
        (lambda request: request.update(seed=3), "request.seed"),
        (lambda request: request.update(episode=4), "request.episode"),
        (lambda request: request.update(prompt=request["prompt"] + " (seed 3)"), "request.prompt"),
        (
            lambda request: request.update({"observation/joint_position": np.zeros(8)}),
            "request.observation/joint_position",
        ),
        (
            lambda request: request.update({"observation/wrist_image_left": np.zeros((224, 225, 3), np.uint8)}),
            "request.observation/wrist_image_left",
        ),
        (lambda request: request.update({"observation/force": np.zeros(1)}), "request.observation/force"),
        (lambda request: request.pop("prompt"), "request.prompt"),
    ],
)  # fmt: skip
def test_what_is_planted_in_an_observation_of_the_openpi_family(
    monkeypatch: pytest.MonkeyPatch, dialect: str, change: Callable[[dict[str, Any]], object], place: str
) -> None:
    monkeypatch.setattr(openpi, "infer_request", also(openpi.infer_request, change))
    # The server may refuse what it did not ask for; the messages have left by then.
    monkeypatch.setattr(RoboArena, "converse", Trusting.converse)
    assert dialect_places(dialect) == {place}


class Trusting(RoboArena):
    def converse(self, connection: Any) -> None:
        from tests.serving.fakes import packed, slow_chunk

        connection.send(packed(self.metadata))
        for frame in connection:
            reset = b"reset" in frame[-40:]
            connection.send("reset successful" if reset else packed(slow_chunk(0, 3)))


@pytest.mark.parametrize(
    ("change", "place"),
    [
        (lambda message: message.update(seed=3), "reset.seed"),
        (lambda message: message.update(episode_idx=3), "reset.episode_idx"),
        (lambda message: message.update(session_id="T1-s003"), "reset.session_id"),
    ],
)
def test_what_is_planted_in_a_reset(
    monkeypatch: pytest.MonkeyPatch, change: Callable[[dict[str, Any]], object], place: str
) -> None:
    monkeypatch.setattr(openpi, "reset_request", also(openpi.reset_request, change))
    assert place in dialect_places("roboarena")


def test_a_session_id_that_is_not_random_or_not_one() -> None:
    sent, card = conversation("roboarena")
    other, _ = conversation("roboarena")
    found = check_conversation([*sent, *other], card, instruction=INSTRUCTION)
    assert found == [("session_id", "2 of them in one trial")]


def test_a_session_id_that_a_seed_chose(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(openpi, "new_session_id", lambda: "00000000-0000-0000-0000-000000000003")
    assert dialect_places("roboarena") == {"request.session_id", "reset.session_id"}


@pytest.mark.parametrize(
    ("kind", "change", "place"),
    [
        ("hello", lambda payload: payload.update(seed=3), "hello.seed"),
        ("hello", lambda payload: payload.update(harness_version="T1-s003"), "hello.harness_version"),
        (
            "episode_start", lambda payload: payload.update(task={"name": INSTRUCTION, "seed": 3}),
            "episode_start.task.seed",
        ),
        (
            "episode_start", lambda payload: payload.update(task={"name": INSTRUCTION, "episode_idx": 3}),
            "episode_start.task.episode_idx",
        ),
        ("episode_start", lambda payload: payload.update(task={"name": "T1-s003"}), "episode_start.task.name"),
        ("episode_start", lambda payload: payload.update(recording={"eid": "3"}), "episode_start.recording"),
        ("observation", lambda payload: payload.update(seed=3), "observation.seed"),
        ("observation", lambda payload: payload.update(contact_force=1.0), "observation.contact_force"),
        ("observation", lambda payload: payload.update(states=np.zeros(9)), "observation.states"),
        ("observation", lambda payload: payload.update(task_description="seed 3"), "observation.task_description"),
        ("observation", lambda payload: payload["images"].update(truth=np.zeros(1)), "observation.images.truth"),
        ("episode_end", lambda payload: payload.update(metrics=1), "episode_end.metrics"),
    ],
)  # fmt: skip
def test_what_is_planted_in_each_message_of_vla_eval(
    monkeypatch: pytest.MonkeyPatch, kind: str, change: Callable[[dict[str, Any]], object], place: str
) -> None:
    honest = vla_eval.message

    def leaky(of: str, payload: dict[str, Any], *, seq: int) -> bytes:
        changed = dict(payload)
        if of == kind:
            change(changed)
        return honest(of, changed, seq=seq)

    monkeypatch.setattr(vla_eval, "message", leaky)
    found = dialect_places("vla-eval")
    assert place in found
    assert all(one.startswith(place) for one in found)


@pytest.mark.parametrize(("field", "value"), [("seq", 1000), ("timestamp", 3.0), ("seed", 3)])
def test_what_is_planted_in_vla_evals_envelope(monkeypatch: pytest.MonkeyPatch, field: str, value: object) -> None:
    honest = vla_eval.pack
    monkeypatch.setattr(vla_eval, "pack", lambda message: honest({**message, field: value}))
    monkeypatch.setattr(vla_eval, "_payload", lambda frame, kind, seq: _trusted(frame))
    assert dialect_places("vla-eval") == {f"message.{field}"}


def _trusted(frame: bytes) -> Any:
    return unpack(frame)["payload"]


def test_privileged_words_are_named_wherever_they_are_not_on_the_list() -> None:
    sent, card = conversation("openpi")
    honest = unpacked_message(sent[0], "openpi")
    from carecontact.serving.openpi import pack

    (found,) = check_conversation([pack({**honest, "task": 1})], card, instruction=INSTRUCTION)
    assert found == (
        "request.task",
        "this key is not on the dialect's list and holds a word of privileged information; no policy may receive it",
    )


# Trials with a server of each dialect under audit: messages are made again without a simulator and a server.


def audited(dialect: str, spec: TrialSpec, keyframe: Keyframe, log: Path) -> Watched:
    make, address = SERVERS[dialect]
    with make().running() as port:
        policy = address.format(port)
        seen = watch(short(spec).model_copy(update={"policy": policy}), policy=policy, prepare=keyframe.parked, log=log)
    assert seen.error is None
    return seen


def test_every_dialect_passes(keyframe: Keyframe, spec: TrialSpec, tmp_path: Path) -> None:
    seen = [audited(dialect, spec, keyframe, tmp_path / "logs" / dialect) for dialect in SERVERS]
    assert [len(trial.sent) for trial in seen] == [1, 3, 5], "with resets, HELLO, start and end"
    part = audit_schema(seen)
    assert part.passed, part.findings
    assert part.counts["messages"] == 9
    part = audit_derivation(tmp_path / "logs", [])
    assert not part.findings
    assert part.counts["observations"] == 4


def test_a_force_in_an_encoder_is_found_in_a_dialect_too(
    monkeypatch: pytest.MonkeyPatch, keyframe: Keyframe, spec: TrialSpec, tmp_path: Path
) -> None:
    def leak(request: dict[str, Any]) -> None:
        request["observation/joint_position"] = request["observation/joint_position"] + np.float64(1e-9)

    monkeypatch.setattr(openpi, "infer_request", also(openpi.infer_request, leak))
    seen = audited("roboarena", spec, keyframe, tmp_path / "logs" / "one")
    assert audit_schema([seen]).passed, "its keys are those of the list"
    assert places(audit_derivation(tmp_path / "logs", [])) == {"observation/joint_position"}


# What the schema part says of single messages.

ALL = PolicyCard(name="all", modalities=MODALITIES, cameras=("overhead",))


def message(**changes: object) -> dict[str, Any]:
    plain = codec.encode_observation(synthetic_observation(cameras={"overhead": synthetic_view()}))
    return {"type": "act", "observation": {**plain, **changes}}


def test_a_message_with_all_that_was_asked_for_is_fine() -> None:
    assert check_message(pack(message()), ALL, joints=7) == []
    assert set().union(*FIELDS_OF.values()) | {"intrinsics", "pose_camera_in_base"} == ALLOWED_IN_VIEW
    assert set(FIELDS_OF) == set(MODALITIES)
    assert {name for name in vars(synthetic_view())} == {name for name in CameraView.__dataclass_fields__}


@pytest.mark.parametrize(
    ("sent", "card", "place", "text"),
    [
        ({**message(), "seed": 3}, ALL, "message", "got ['observation', 'seed', 'type']"),
        ([1], ALL, "message", "got list"),
        (message(contact_force=1.0), ALL, "observation.contact_force", "privileged"),
        (message(velocity_tcp_in_base=np.zeros(6)), ALL, "observation.velocity_tcp_in_base", "without a request"),
        (message(), replace(ALL, tool_velocity=True), "observation.velocity_tcp_in_base", "was not sent, although"),
        (message(contact_force=1.0), ALL, "observation", "unknown key contact_force"),
        (message(joint_position=np.zeros(8)), ALL, "observation", "expected float64 (joints)"),
        (message(joint_position=np.zeros(8), joint_velocity=np.zeros(8)), ALL, "observation.joint_position", "got 8"),
        (message(), None, "card", "showed no card"),
        (
            message(),
            PolicyCard(name="blind", cameras=()),
            "observation.cameras",
            "requests none, but the message holds ['overhead']",
        ),
        (
            message(),
            PolicyCard(name="rgb", modalities=("rgb",)),
            "observation.cameras.overhead.landmarks",
            "does not request it",
        ),
    ],
)
def test_what_is_wrong_is_named(sent: object, card: PolicyCard | None, place: str, text: str) -> None:
    found = check_message(pack(sent), card, joints=7)
    assert any(where == place and text in reason for where, reason in found), found


@pytest.mark.parametrize(
    ("error", "named"),
    [
        ("observation: unknown key contact_force; valid: cameras", ["observation.contact_force"]),
        ("observation: unknown key force, seed; valid: cameras", ["observation.force", "observation.seed"]),
        ("observation.cameras.wrist: unknown key truth; valid: rgb", ["observation.cameras.wrist.truth"]),
        ("observation.joint_position: expected float64 (7)", ["trial"]),
    ],
)
def test_a_key_that_was_refused_is_named(error: str, named: list[str]) -> None:
    trace = f"policy 'p' failed at act: Traceback (most recent call last):\n  File\ncarecontact.errors.Some: {error}"
    assert failed_at(trace) == named

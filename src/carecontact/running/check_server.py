"""What ``carecontact check`` finds out about a policy's server before a long run: its health, latency, answers."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from http.client import HTTPConnection, HTTPException
from pathlib import Path
from typing import Self

import numpy as np
import numpy.typing as npt

from carecontact.episode.episode import Episode
from carecontact.errors import ActionError, PolicyError
from carecontact.interface.action import Action
from carecontact.interface.observation import Observation
from carecontact.interface.policy import PolicyCard, PolicyRef
from carecontact.interface.robot import Session
from carecontact.protocol.protocol import TrialSpec
from carecontact.running import check_answers, check_inputs
from carecontact.running.check_answers import save_sheet
from carecontact.running.check_inputs import Ablation, Effect, inputs_of
from carecontact.running.trial import CheckFinding, Level
from carecontact.serving.conversation import PolicyConversation, PolicySetup, readable
from carecontact.serving.dialect_media import JOINTS, WIDTH
from carecontact.serving.opening import HIDDEN

# Sends one request after another to one policy, each as if a trial began with it.


class RepeatedRequest:
    """Makes each request a trial of its own, so that a server that keeps a plan or a chunk answers the present
    request.
    """

    def __init__(
        self,
        conversation: PolicyConversation,
        session: Session,
        *,
        check: Callable[[Action], object],
        listen: Callable[[PolicyConversation], None],
        reopen: Callable[[], PolicyConversation],
        took_s: list[float],
    ) -> None:
        self._conversation, self._session = conversation, session
        self._check, self._listen, self._reopen, self._took_s = check, listen, reopen, took_s
        self._own: PolicyConversation | None = None
        self.last: Sequence[Action] = ()
        """Actions of the last answer."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._own is not None:
            self._own.close()

    def ask(self, observation: Observation, *, may_refuse: bool) -> Sequence[Action] | None:
        """Return the answer; None if the policy refuses, after which it is connected again.

        Raises PolicyError if the policy fails and ``may_refuse`` is false.
        """
        try:
            self._begin(observation.instruction)
            started = time.monotonic()
            self.last = self._conversation.act(observation).actions
            self._took_s.append(time.monotonic() - started)
            for number, action in enumerate(self.last):
                try:
                    self._check(action)
                except ActionError as error:
                    self._conversation.refuse(number, error)
        except PolicyError:
            if not may_refuse:
                raise
            self._connect_again()
            return None
        return self.last

    def _begin(self, instruction: str) -> None:
        """Begin a trial; a policy that accepts only one reset on each connection gets a new connection."""
        try:
            self._conversation.reset(instruction, self._session)
        except PolicyError:
            self._connect_again()
            self._conversation.reset(instruction, self._session)

    def _connect_again(self) -> None:
        if self._own is not None:
            self._own.close()
        self._conversation = self._own = self._reopen()
        self._listen(self._own)
        self._own.start()


# Asks a server whether it is healthy, at the address that its kind offers for this.

PATHS = {"openpi": ("/healthz",), "roboarena": ("/healthz", "/health"), "vla-eval": ("/health",)}
"""Scheme -> paths at which its servers answer a plain HTTP request. RoboArena's servers copy openpi's; vllm-omni has
/health."""
DEADLINE_S = 5.0
SHOWN_BYTES = 200


def health(ref: PolicyRef) -> CheckFinding | None:
    """Ask a remote policy's server; return None for a kind of server without such an address.

    It is no fault if a server lacks the address. Nor is it if a server does not listen: the connection will show that.
    """
    for path in PATHS.get(ref.scheme, ()):
        try:
            status, text = _get(ref, path)
        except (OSError, HTTPException, ValueError):
            continue
        if status == 200:
            return CheckFinding(level="ok", topic="health", text=f"{path} answers {text or 'with no text'}")
        if status >= 500:
            return CheckFinding(level="warning", topic="health", text=f"{path} answers HTTP {status} {text}")
    return None


def _get(ref: PolicyRef, path: str) -> tuple[int, str]:
    # http.client uses no proxy of the environment.
    connection = HTTPConnection(ref.host, ref.port, timeout=DEADLINE_S)
    try:
        connection.request("GET", path)
        response = connection.getresponse()
        return response.status, readable(" ".join(response.read(SHOWN_BYTES).decode(errors="replace").split()))
    finally:
        connection.close()


# How long a policy takes for an answer, and what that means for a trial.


def latency_findings(took_s: Sequence[float], *, seconds: float, limit_s: float) -> Iterator[CheckFinding]:
    """Yield findings about how long answers take.

    Args:
        took_s: wall time of every call [s].
        seconds: simulated time for which one answer lasts [s].
        limit_s: simulated time of a trial [s].
    """
    half, most = np.percentile(took_s, [50, 95])
    calls = int(np.ceil(limit_s / seconds))
    text = (
        f"p50 {1000 * half:.0f} ms, p95 {1000 * most:.0f} ms over {len(took_s)} calls; each gives {seconds:.2f} s of "
        f"motion, so a trial of {limit_s:g} s makes {calls} of them and waits {calls * half:.0f} s"
    )
    yield CheckFinding(level="ok", topic="latency", text=text)
    if most > seconds >= half:
        yield CheckFinding(
            level="hint",
            topic="latency",
            text="some calls take longer than their motion: a real robot would wait for them",
        )


# Makes one line about the effect of each input.


def effect_finding(effect: Effect) -> CheckFinding:
    """Return a warning if an input without effect is probably a mistake, and a hint if it may be none."""
    name = effect.input.name
    if effect.refused:
        return CheckFinding(level="ok", topic="input", text=f"{name}: used; the policy refuses it blanked")
    repeats = f"repeats differ by {effect.spread:.2g}" if effect.spread else "repeats are equal"
    calls = f"{effect.calls} call{'' if effect.calls == 1 else 's'}"
    seen = f"blanked, the answer moves by {effect.moved:.2g}, {repeats} ({calls})"
    if effect.verdict == "used":
        return CheckFinding(level="ok", topic="input", text=f"{name}: used; {seen}")
    if effect.verdict == "unclear":
        return CheckFinding(
            level="hint", topic="input", text=f"{name}: no effect seen in too few calls to tell; {seen}"
        )
    if not effect.input.needed:
        return CheckFinding(level="hint", topic="input", text=f"{name}: no effect; {seen}. Many policies do without it")
    why = "the server does not read this key, expects it under another name, or ignores it"
    return CheckFinding(level="warning", topic="input", text=f"{name}: no effect; {seen}: {why}")


# The deep check of one policy: what its server states, receives and answers, and which inputs the policy uses.

F64 = npt.NDArray[np.float64]

MEANINGS = {
    "image_resolution": "height and width of every picture [px]",
    "needs_wrist_camera": "whether it wants the wrist camera",
    "n_external_cameras": "how many exterior cameras it wants",
    "needs_stereo_camera": "whether it wants both pictures of a stereo camera",
    "needs_session_id": "whether it wants a random id of each trial",
    "action_space": "what its actions are",
    "observation_params.send_wrist_image": "whether it wants the wrist camera",
    "observation_params.send_state": "whether it wants joint angles and gripper",
}
"""Key that a server's metadata may have -> its meaning in words."""
ENVELOPE = ("type", "seq", "timestamp")
INSTRUCTIONS = ("prompt", "payload.task_description", "observation.instruction")
"""Keys of the instruction; every message that carries an observation has one of them."""


class ServerCheck:
    """Listens to a conversation and reports what is said; then asks again with each input blanked."""

    def __init__(
        self,
        *,
        spec: TrialSpec,
        policy: PolicySetup,
        pictures: Path,
        say: Callable[[CheckFinding], None],
        reopen: Callable[[], PolicyConversation],
    ) -> None:
        """
        Args:
            pictures: PNG file to write.
            reopen: makes another conversation with the policy, not started, after it refused an observation.
        """
        self._spec, self._policy, self._pictures, self._tell, self._reopen = spec, policy, pictures, say, reopen
        self._scheme = policy.ref.scheme
        self._card: PolicyCard | None = None
        self._greeting: bytes | str | None = None
        self._sent, self._answer = b"", None
        self._told: set[str] = set()
        self._took_s: list[float] = []

    def listen(self, conversation: PolicyConversation) -> None:
        """Listen to all messages of a conversation that begins."""
        conversation.on_sent, conversation.on_received = self._on_sent, self._on_received

    def before(self) -> None:
        """Report what can be found out before the connection."""
        if found := health(self._policy.ref):
            self._say(found)

    def greeted(self, card: PolicyCard) -> None:
        self._card = card
        self._metadata()

    def refused(self, observation: Observation | None) -> None:
        """Report all that was heard from a policy that has failed, unless it was reported already."""
        self._metadata()
        if observation is not None and self._has_asked():
            self._request()
            chunk = None if self._answer is None else check_inputs.chunk_of(self._answer, self._scheme)
            if chunk is not None:
                self._columns(chunk, observation, kind="joints")

    def answered(self, actions: Sequence[Action], observation: Observation) -> None:
        """Report what was sent and what came back."""
        self._request()
        chunk = None if self._answer is None else check_inputs.chunk_of(self._answer, self._scheme)
        joints = check_answers.joints_of(actions) if chunk is None else chunk[:, :JOINTS]
        card, count = self._known, len(actions) if chunk is None else len(chunk)
        executed = "all of them are" if count == len(actions) else f"the first {len(actions)} are"
        seconds = len(actions) / card.control_hz
        steps = f"{count} step{'' if count == 1 else 's'}"
        self._found("ok", "chunk", f"{steps}; {executed} executed, {seconds:.2f} s at {card.control_hz:g} Hz")
        if joints is None:
            poses = [a.pose_tcp_in_base for a in actions if a.pose_tcp_in_base is not None]
            if poses:
                self._columns(np.array(poses, np.float64), observation, kind="poses")
            return
        self._columns(joints if chunk is None else chunk, observation, kind="joints")
        for found in check_answers.look_at_joints(joints, space=card.action_space, now=observation.joint_position):
            self._say(found)
        if chunk is not None and chunk.shape[1] > JOINTS and self._scheme != "vla-eval":
            for found in check_answers.look_at_gripper(chunk[:, -1]):
                self._say(found)

    def ask_again(self, conversation: PolicyConversation, observation: Observation, episode: Episode) -> None:
        """Blank each input in turn. Raises PolicyError if the policy fails at the unchanged observation."""
        session = episode.session
        asking = RepeatedRequest(
            conversation, session, check=episode.check, listen=self.listen, reopen=self._reopen, took_s=self._took_s
        )
        ask = asking.ask

        def numbers(seen: Observation) -> F64 | None:
            reply = ask(seen, may_refuse=seen is not observation)
            if reply is None:
                return None
            chunk = None if self._answer is None else check_inputs.chunk_of(self._answer, self._scheme)
            return check_answers.numbers_of(reply) if chunk is None else chunk

        with asking:
            ablation = Ablation(numbers, observation, inputs_of(observation, self._known, session, sent=self._sent))
            effects = []
            for effect in ablation.run(self._plan):
                self._say(effect_finding(effect))
                effects.append(effect)
        self._polarity(ablation.plain, effects)
        seconds = len(asking.last) / self._known.control_hz
        for found in latency_findings(self._took_s, seconds=seconds, limit_s=self._spec.protocol.phases.time_limit_s):
            self._say(found)

    def _on_sent(self, message: bytes) -> None:
        self._sent, self._answer = message, None

    def _on_received(self, frame: bytes | str) -> None:
        self._greeting = frame if self._greeting is None else self._greeting
        self._answer = frame

    @property
    def _known(self) -> PolicyCard:
        assert self._card is not None
        return self._card

    def _say(self, finding: CheckFinding) -> None:
        """Report a finding without the credentials, which a server may have repeated."""
        secret = self._policy.ref.credentials
        self._tell(replace(finding, text=finding.text.replace(secret, HIDDEN)) if secret else finding)

    def _found(self, level: Level, topic: str, text: str) -> None:
        self._say(CheckFinding(level=level, topic=topic, text=text))

    def _once(self, topic: str) -> bool:
        new = topic not in self._told
        self._told.add(topic)
        return new

    def _has_asked(self) -> bool:
        return any(key in INSTRUCTIONS for key in check_inputs.decoded(self._sent, self._scheme))

    def _metadata(self) -> None:
        """Report a server's metadata; a native server has none besides its card."""
        if self._scheme not in check_inputs.DIALECTS or self._greeting is None or not self._once("metadata"):
            return
        found = {
            key.removeprefix("payload."): value
            for key, value in check_inputs.decoded(self._greeting, self._scheme).items()
            if key and key not in ENVELOPE
        }
        if not found:
            self._found("ok", "metadata", "the server says nothing of itself; the address decides what it is sent")
            return
        lines = [
            f"{line}{f'  ({MEANINGS[key]})' if key in MEANINGS else ''}"
            for key, line in zip(found, check_inputs.listed(found), strict=True)
        ]
        self._found("ok", "metadata", "\n".join(["the server says of itself", *lines]))

    def _request(self) -> None:
        if not self._once("sent"):
            return
        sent = check_inputs.decoded(self._sent, self._scheme)
        self._found("ok", "sent", "\n".join([f"{len(self._sent) / 1000:.0f} kB with", *check_inputs.listed(sent)]))
        shown = check_inputs.pictures(sent)
        if shown:
            title = f"Sent to {self._policy.ref} in {self._spec.trial_id}, pixel for pixel, without the coloured frames"
            save_sheet(shown, self._pictures, names=check_inputs.camera_names(self._known), title=title)
            self._found("ok", "pictures", f"{self._pictures} shows them as they are sent: look at it")

    def _columns(self, values: F64, observation: Observation, *, kind: str) -> None:
        steps, width = values.shape
        more = f"; expected {WIDTH}, seven joints and the gripper" if width > WIDTH else ""
        shape = f"{steps} step{'' if steps == 1 else 's'} of {width} columns{more}"
        lines = check_answers.table(values, now=observation.joint_position, kind=kind)
        self._found("ok", "columns", "\n".join([shape, *lines]))

    def _plan(self, calls: int, seconds: float) -> None:
        text = f"answers to one request differ: {calls} more calls, about {seconds:.0f} s"
        self._found("wait", "inputs", text)

    def _polarity(self, plain: Sequence[F64], effects: Sequence[Effect]) -> None:
        told = [effect for effect in effects if effect.input.is_gripper and effect.answers]
        if self._scheme not in ("openpi", "roboarena") or not told or plain[0].shape[1] <= JOINTS:
            return
        closed, opened = (np.concatenate([chunk[:, -1] for chunk in chunks]) for chunks in (plain, told[0].answers))
        for found in check_answers.look_at_polarity(closed, opened):
            self._say(found)

"""The deep check of a policy: what its server states, receives and answers, its latency, and the inputs that it
uses."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import replace
from http.client import HTTPConnection, HTTPException
from pathlib import Path

import numpy as np

from carecontact.episode.episode import Episode
from carecontact.errors import ActionError, PolicyError, counted
from carecontact.interface.action import Action
from carecontact.interface.deltas import DELTAS, DeltaConvention
from carecontact.interface.deltas import WIDTH as DELTA_WIDTH
from carecontact.interface.observation import F64, U8, Observation
from carecontact.interface.policy import PolicyCard, PolicyRef
from carecontact.interface.robot import Session
from carecontact.protocol.protocol import TrialSpec
from carecontact.running import check_answers, check_messages
from carecontact.running.check_answers import CheckFinding, Level
from carecontact.running.check_arrows import with_arrows
from carecontact.running.check_deltas import Questions, absolute, look_at_deltas
from carecontact.running.check_inputs import BUDGET_S, FEWEST, Ablation, Effect, inputs_of
from carecontact.serving.cartesian import SETUPS
from carecontact.serving.conversation import PolicyConversation, PolicySetup, readable
from carecontact.serving.dialect_media import JOINTS, WIDTH
from carecontact.serving.opening import HIDDEN
from carecontact.serving.sent_message import rebuilt_message

PATHS = {"openpi": ("/healthz",), "roboarena": ("/healthz", "/health"), "vla-eval": ("/health",)}
"""Scheme -> paths at which its servers answer a plain HTTP request. RoboArena's servers copy openpi's; vllm-omni has
/health."""
DEADLINE_S = 5.0
SHOWN_BYTES = 200
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


class RepeatedRequest:
    """Makes each request a trial of its own, so that a server that keeps a plan or a chunk answers the present
    request."""

    def __init__(
        self,
        conversation: PolicyConversation,
        session: Session,
        *,
        check: Callable[[Action], object],
        listen: Callable[[PolicyConversation], None],
        reopen: Callable[[], PolicyConversation],
    ) -> None:
        self._conversation, self._session = conversation, session
        self._check, self._listen, self._reopen = check, listen, reopen
        self._own: PolicyConversation | None = None
        self.last: Sequence[Action] = ()
        self.took_s: list[float] = []

    def close(self) -> None:
        if self._own is not None:
            self._own.close()

    def ask(self, observation: Observation, *, may_refuse: bool) -> Sequence[Action] | None:
        """Return the answer; None if the policy refuses, after which it is connected again."""
        try:
            try:
                self._conversation.reset(observation.instruction, self._session)
            except PolicyError:
                # A policy that accepts only one reset on each connection gets a new connection.
                self._connect_again()
                self._conversation.reset(observation.instruction, self._session)
            started = time.monotonic()
            self.last = self._conversation.act(observation).actions
            self.took_s.append(time.monotonic() - started)
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

    def _connect_again(self) -> None:
        self.close()
        self._conversation = self._own = self._reopen()
        self._listen(self._own)
        self._own.start()


def health(ref: PolicyRef) -> CheckFinding | None:
    """Ask a remote policy's server. It is no fault if it lacks such an address, and the connection shows others."""
    for path in PATHS.get(ref.scheme, ()):
        # http.client uses no proxy of the environment.
        connection = HTTPConnection(ref.host, ref.port, timeout=DEADLINE_S)
        try:
            connection.request("GET", path)
            response = connection.getresponse()
            text = readable(" ".join(response.read(SHOWN_BYTES).decode(errors="replace").split()))
        except (OSError, HTTPException, ValueError):
            continue
        finally:
            connection.close()
        if response.status == 200:
            return CheckFinding("ok", "health", f"{path} answers {text or 'with no text'}")
        if response.status >= 500:
            return CheckFinding("warning", "health", f"{path} answers HTTP {response.status} {text}")
    return None


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
    yield CheckFinding("ok", "latency", text)
    if most > seconds >= half:
        text = "some calls take longer than their motion: a real robot would wait for them"
        yield CheckFinding("hint", "latency", text)


def effect_finding(effect: Effect) -> CheckFinding:
    """Return a warning if an input without effect is probably a mistake, and a hint if it may be none."""
    name = effect.input.name
    if effect.refused:
        return CheckFinding("ok", "input", f"{name}: used; the policy refuses it blanked")
    repeats = f"repeats differ by {effect.spread:.2g}" if effect.spread else "repeats are equal"
    seen = f"blanked, the answer moves by {effect.moved:.2g}, {repeats} ({counted(effect.calls, 'call')})"
    if effect.verdict == "used":
        return CheckFinding("ok", "input", f"{name}: used; {seen}")
    if effect.verdict == "unclear":
        return CheckFinding("hint", "input", f"{name}: no effect seen in too few calls to tell; {seen}")
    if not effect.input.needed:
        return CheckFinding("hint", "input", f"{name}: no effect; {seen}. Many policies do without it")
    why = "the server does not read this key, expects it under another name, or ignores it"
    return CheckFinding("warning", "input", f"{name}: no effect; {seen}: {why}")


class ServerCheck:
    """Listens to a conversation and reports its content; then asks again with each input blanked."""

    def __init__(
        self,
        *,
        spec: TrialSpec,
        policy: PolicySetup,
        pictures: Path,
        on_finding: Callable[[CheckFinding], None],
        reopen: Callable[[], PolicyConversation],
    ) -> None:
        """
        Args:
            pictures: PNG file to write.
            reopen: makes another conversation with the policy, not started, after it refused an observation.
        """
        self._spec, self._policy, self._sheet, self._reopen = spec, policy, pictures, reopen
        self._on_finding, self._scheme = on_finding, policy.ref.scheme
        self._card: PolicyCard | None = None
        self._greeting: bytes | str | None = None
        self._sent, self._answer = b"", None
        self._reported: set[str] = set()
        self._absolute = ""
        """What shows that the deltas of the answer are absolute positions; empty if nothing does."""

    def listen(self, conversation: PolicyConversation) -> None:
        conversation.on_sent, conversation.on_received = self._on_sent, self._on_received

    def before(self) -> None:
        if found := health(self._policy.ref):
            self._report(found)

    def greeted(self, card: PolicyCard) -> None:
        self._card = card
        self._metadata()

    def refused(self, observation: Observation | None) -> None:
        """Report all that was heard from a policy that has failed, unless it was reported already."""
        self._metadata()
        sent = check_messages.decoded(self._sent, self._scheme)
        if observation is not None and any(key in INSTRUCTIONS for key in sent):
            self._request()
            if (chunk := self._chunk()) is not None:
                self._columns(chunk, observation, kind="deltas" if self._known.delta else "joints")

    def answered(self, actions: Sequence[Action], observation: Observation) -> None:
        chunk, convention = self._chunk(), self._convention
        self._request(() if convention is None else (observation, _deltas_of(actions), convention))
        joints = check_answers.joints_of(actions) if chunk is None else chunk[:, :JOINTS]
        card, count = self._known, len(actions) if chunk is None else len(chunk)
        executed = "all of them are" if count == len(actions) else f"the first {len(actions)} are"
        seconds = len(actions) / card.control_hz
        text = f"{counted(count, 'step')}; {executed} executed, {seconds:.2f} s at {card.control_hz:g} Hz"
        self._found("ok", "chunk", text)
        if convention is not None:
            numbers = _deltas_of(actions) if chunk is None else chunk
            self._columns(numbers, observation, kind="deltas")
            if numbers.shape[1] >= 6:
                self._look_at_deltas(numbers[:, :6], convention, observation)
            if chunk is not None and chunk.shape[1] == DELTA_WIDTH:
                closed, opened = convention.gripper
                self._report(*check_answers.look_at_gripper(chunk[:, -1], closed=closed, opened=opened))
            return
        if joints is None:
            poses = [a.pose_tcp_in_base for a in actions if a.pose_tcp_in_base is not None]
            if poses:
                self._columns(np.array(poses, np.float64), observation, kind="poses")
            return
        self._columns(joints if chunk is None else chunk, observation, kind="joints")
        self._report(*check_answers.look_at_joints(joints, space=card.action_space, now=observation.joint_position))
        if chunk is not None and chunk.shape[1] > JOINTS and self._scheme != "vla-eval":
            self._report(*check_answers.look_at_gripper(chunk[:, -1]))

    def _look_at_deltas(self, numbers: F64, convention: DeltaConvention, observation: Observation) -> None:
        setup = SETUPS.get(self._known.arguments.get("profile", ""))
        state = None if setup is None else (setup.vla_state if self._scheme == "vla-eval" else setup.state)
        sent_m = None if state is None else state(observation)[:3]
        self._absolute = absolute(numbers[0], observation.pose_tcp_in_base, sent_m)
        if self._absolute:
            text = "the numbers look like absolute positions of the tool"
            text += f", and differences are expected: {self._absolute}; declared: {convention.description}"
            self._found("warning", "deltas", text)
        else:
            self._report(*look_at_deltas(numbers, convention))

    def ask_again(self, conversation: PolicyConversation, observation: Observation, episode: Episode) -> None:
        session = episode.session
        asking = RepeatedRequest(conversation, session, check=episode.check, listen=self.listen, reopen=self._reopen)

        def numbers(seen: Observation) -> F64 | None:
            reply = asking.ask(seen, may_refuse=seen is not observation)
            if reply is None:
                return None
            chunk = self._chunk()
            return check_answers.numbers_of(reply) if chunk is None else chunk

        with closing(asking):
            ablation = Ablation(numbers, observation, inputs_of(observation, self._known, session, sent=self._sent))
            effects: list[Effect] = []
            for effect in ablation.run(self._plan):
                self._report(effect_finding(effect))
                effects.append(effect)
            self._ask_about_deltas(asking, observation, episode)
        self._polarity(ablation.plain, effects)
        seconds, limit_s = len(asking.last) / self._known.control_hz, self._spec.protocol.phases.time_limit_s
        self._report(*latency_findings(asking.took_s, seconds=seconds, limit_s=limit_s))

    def _ask_about_deltas(self, asking: RepeatedRequest, observation: Observation, episode: Episode) -> None:
        """Report wrong axes of the deltas and a wrong orientation of the pictures."""
        convention = self._convention
        if convention is None:
            return
        if self._absolute:
            self._found("hint", "axes", "not asked, since the numbers look like absolute positions")
            return

        def ask(seen: Observation) -> F64 | None:
            reply = asking.ask(seen, may_refuse=seen is not observation)
            if reply is None:
                return None
            chunk = self._chunk()
            # As the server gives them: those that are executed have been moved onto the bounds.
            if chunk is not None and chunk.shape[1] == DELTA_WIDTH:
                return chunk[: len(reply), :6]
            return _deltas_of(reply)

        plain = [numbers for _ in range(FEWEST) if (numbers := ask(observation)) is not None]
        call_s = float(np.median(asking.took_s))
        questions = Questions(ask, observation, convention, plain, most_calls=BUDGET_S / max(call_s, 1e-6))
        slow_s = questions.calls * call_s
        if slow_s > BUDGET_S:
            self._found("hint", "axes", f"{questions.calls} more calls would take {slow_s:.0f} s: nothing is asked")
            return
        site = episode.simulation.data.site(f"region_{episode.task.region}")
        region_m = episode.simulation.encoders.in_base(episode.simulation.data, site.xpos, site.xmat)[:3, 3]
        orientation = self._known.arguments.get("orientation", "upright")
        self._report(*questions.run(region_m=region_m, orientation=orientation))

    def _on_sent(self, message: bytes) -> None:
        self._sent, self._answer = message, None

    def _on_received(self, frame: bytes | str) -> None:
        self._greeting = frame if self._greeting is None else self._greeting
        self._answer = frame

    @property
    def _convention(self) -> DeltaConvention | None:
        return DELTAS[self._known.delta] if self._known.delta else None

    @property
    def _known(self) -> PolicyCard:
        assert self._card is not None
        return self._card

    def _chunk(self) -> F64 | None:
        return check_messages.chunk_of(self._answer, self._scheme)

    def _report(self, *findings: CheckFinding) -> None:
        """Report findings without the credentials, which a server may have repeated."""
        secret = self._policy.ref.credentials
        for finding in findings:
            self._on_finding(replace(finding, text=finding.text.replace(secret, HIDDEN)) if secret else finding)

    def _found(self, level: Level, topic: str, *lines: str) -> None:
        self._report(CheckFinding(level, topic, "\n".join(lines)))

    def _is_new(self, topic: str) -> bool:
        new = topic not in self._reported
        self._reported.add(topic)
        return new

    def _metadata(self) -> None:
        """Report a server's metadata; a native server has none besides its card."""
        if self._scheme not in check_messages.DIALECTS or self._greeting is None or not self._is_new("metadata"):
            return
        found = {
            key.removeprefix("payload."): value
            for key, value in check_messages.decoded(self._greeting, self._scheme).items()
            if key and key not in ENVELOPE
        }
        if not found:
            self._found("ok", "metadata", "the server says nothing of itself; the address decides what it is sent")
            return
        lines = zip(found, check_messages.listed(found), strict=True)
        explained = [f"{line}  ({MEANINGS[key]})" if key in MEANINGS else line for key, line in lines]
        self._found("ok", "metadata", "the server says of itself", *explained)

    def _request(self, answer: tuple[()] | tuple[Observation, F64, DeltaConvention] = ()) -> None:
        """``answer``: observation, numbers (steps, 6) and convention of deltas, which are drawn into the pictures."""
        if not self._is_new("sent"):
            return
        sent = check_messages.decoded(self._sent, self._scheme)
        self._found("ok", "sent", f"{len(self._sent) / 1000:.0f} kB with", *check_messages.listed(sent))
        if shown := check_messages.pictures(sent):
            title = f"Sent to {self._policy.ref} in {self._spec.trial_id}, pixel for pixel, without the coloured frames"
            names, arrows = check_messages.camera_names(self._known), {}
            if answer:
                arrows = with_arrows(*answer, sent=self._pictures_of, cameras=names)
            check_messages.save_sheet(shown, self._sheet, names=names, title=title, enlarged=arrows)
            self._found("ok", "pictures", f"{self._sheet} shows them as they are sent: look at it")

    def _pictures_of(self, observation: Observation) -> dict[str, U8]:
        again = rebuilt_message(observation, self._known.arguments, self._known.cameras, sent=self._sent)
        return check_messages.pictures(check_messages.decoded(again, self._scheme))

    def _columns(self, values: F64, observation: Observation, *, kind: str) -> None:
        steps, width = values.shape
        most = DELTA_WIDTH if kind == "deltas" else WIDTH
        of = "three of translation, three of rotation" if kind == "deltas" else "seven joints"
        more = f"; expected {most}, {of} and the gripper" if width > most else ""
        lines = check_answers.table(values, now=observation.joint_position, kind=kind)
        self._found("ok", "columns", f"{counted(steps, 'step')} of {width} columns{more}", *lines)

    def _plan(self, calls: int, seconds: float) -> None:
        self._found("wait", "inputs", f"answers to one request differ: {calls} more calls, about {seconds:.0f} s")

    def _polarity(self, plain: Sequence[F64], effects: Sequence[Effect]) -> None:
        opened = next((effect.answers for effect in effects if effect.input.is_gripper and effect.answers), ())
        convention, width = self._convention, plain[0].shape[1]
        joints = self._scheme in ("openpi", "roboarena") and convention is None and width > JOINTS
        rows = self._scheme in check_messages.DIALECTS and convention is not None and width == DELTA_WIDTH
        if opened and (joints or rows):
            commands = (np.concatenate([chunk[:, -1] for chunk in chunks]) for chunks in (plain, opened))
            closed, open_ = (1.0, 0.0) if convention is None else convention.gripper
            self._report(*check_answers.look_at_polarity(*commands, closed=closed, opened=open_))


def _deltas_of(actions: Sequence[Action]) -> F64:
    """Return the numbers (steps, 6) of actions; an action that keeps the last target is left out."""
    return np.array([action.delta for action in actions if action.delta is not None], np.float64).reshape(-1, 6)

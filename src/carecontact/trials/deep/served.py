"""The deep check of one policy: what its server states, receives and answers, and which inputs the policy uses."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from carecontact.contract.action import Action
from carecontact.contract.observation import Observation
from carecontact.contract.policy import PolicyCard
from carecontact.contract.trial import TrialSpec
from carecontact.episode.episode import Episode
from carecontact.hosting.conversation import PolicyConversation
from carecontact.hosting.dialects.chunks import JOINTS, WIDTH
from carecontact.hosting.remote import HIDDEN
from carecontact.hosting.setup import PolicySetup
from carecontact.trials.deep import columns, messages
from carecontact.trials.deep.ablation import Ablation, Effect
from carecontact.trials.deep.asking import Asking
from carecontact.trials.deep.health import health
from carecontact.trials.deep.inputs import inputs_of
from carecontact.trials.deep.latency import latency_findings
from carecontact.trials.deep.sheet import save_sheet
from carecontact.trials.deep.verdicts import effect_finding
from carecontact.trials.finding import Finding, Level

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


class DeepCheck:
    """Listens to a conversation and reports what is said; then asks again with each input blanked."""

    def __init__(
        self,
        *,
        spec: TrialSpec,
        policy: PolicySetup,
        pictures: Path,
        say: Callable[[Finding], None],
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
            chunk = None if self._answer is None else messages.chunk_of(self._answer, self._scheme)
            if chunk is not None:
                self._columns(chunk, observation, kind="joints")

    def answered(self, actions: Sequence[Action], observation: Observation) -> None:
        """Report what was sent and what came back."""
        self._request()
        chunk = None if self._answer is None else messages.chunk_of(self._answer, self._scheme)
        joints = columns.joints_of(actions) if chunk is None else chunk[:, :JOINTS]
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
        for found in columns.look_at_joints(joints, space=card.action_space, now=observation.joint_position):
            self._say(found)
        if chunk is not None and chunk.shape[1] > JOINTS and self._scheme != "vla-eval":
            for found in columns.look_at_gripper(chunk[:, -1]):
                self._say(found)

    def ask_again(self, conversation: PolicyConversation, observation: Observation, episode: Episode) -> None:
        """Blank each input in turn. Raises PolicyError if the policy fails at the unchanged observation."""
        session = episode.session
        asking = Asking(
            conversation, session, check=episode.check, listen=self.listen, reopen=self._reopen, took_s=self._took_s
        )
        ask = asking.ask

        def numbers(seen: Observation) -> F64 | None:
            reply = ask(seen, may_refuse=seen is not observation)
            if reply is None:
                return None
            chunk = None if self._answer is None else messages.chunk_of(self._answer, self._scheme)
            return columns.numbers_of(reply) if chunk is None else chunk

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

    def _say(self, finding: Finding) -> None:
        """Report a finding without the credentials, which a server may have repeated."""
        secret = self._policy.ref.credentials
        self._tell(replace(finding, text=finding.text.replace(secret, HIDDEN)) if secret else finding)

    def _found(self, level: Level, topic: str, text: str) -> None:
        self._say(Finding(level=level, topic=topic, text=text))

    def _once(self, topic: str) -> bool:
        new = topic not in self._told
        self._told.add(topic)
        return new

    def _has_asked(self) -> bool:
        return any(key in INSTRUCTIONS for key in messages.decoded(self._sent, self._scheme))

    def _metadata(self) -> None:
        """Report a server's metadata; a native server has none besides its card."""
        if self._scheme not in messages.DIALECTS or self._greeting is None or not self._once("metadata"):
            return
        found = {
            key.removeprefix("payload."): value
            for key, value in messages.decoded(self._greeting, self._scheme).items()
            if key and key not in ENVELOPE
        }
        if not found:
            self._found("ok", "metadata", "the server says nothing of itself; the address decides what it is sent")
            return
        lines = [
            f"{line}{f'  ({MEANINGS[key]})' if key in MEANINGS else ''}"
            for key, line in zip(found, messages.listed(found), strict=True)
        ]
        self._found("ok", "metadata", "\n".join(["the server says of itself", *lines]))

    def _request(self) -> None:
        if not self._once("sent"):
            return
        sent = messages.decoded(self._sent, self._scheme)
        self._found("ok", "sent", "\n".join([f"{len(self._sent) / 1000:.0f} kB with", *messages.listed(sent)]))
        shown = messages.pictures(sent)
        if shown:
            title = f"Sent to {self._policy.ref} in {self._spec.trial_id}, pixel for pixel, without the coloured frames"
            save_sheet(shown, self._pictures, names=messages.camera_names(self._known), title=title)
            self._found("ok", "pictures", f"{self._pictures} shows them as they are sent: look at it")

    def _columns(self, values: F64, observation: Observation, *, kind: str) -> None:
        steps, width = values.shape
        more = f"; expected {WIDTH}, seven joints and the gripper" if width > WIDTH else ""
        shape = f"{steps} step{'' if steps == 1 else 's'} of {width} columns{more}"
        lines = columns.table(values, now=observation.joint_position, kind=kind)
        self._found("ok", "columns", "\n".join([shape, *lines]))

    def _plan(self, calls: int, seconds: float) -> None:
        text = f"answers to one request differ: {calls} more calls, about {seconds:.0f} s"
        self._found("wait", "inputs", text)

    def _polarity(self, plain: Sequence[F64], effects: Sequence[Effect]) -> None:
        told = [effect for effect in effects if effect.input.is_gripper and effect.answers]
        if self._scheme not in ("openpi", "roboarena") or not told or plain[0].shape[1] <= JOINTS:
            return
        closed, opened = (np.concatenate([chunk[:, -1] for chunk in chunks]) for chunks in (plain, told[0].answers))
        for found in columns.look_at_polarity(closed, opened):
            self._say(found)

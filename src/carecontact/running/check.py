"""Tries a policy on one real observation: it starts the policy, reads its card and requests two answers. Nothing is
recorded."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from carecontact.episode.episode import Episode
from carecontact.episode.randomization import settled_world
from carecontact.errors import ActionError, PolicyError, counted
from carecontact.interface.action import Action, looks_like_millimetres
from carecontact.interface.observation import Observation
from carecontact.interface.policy import PolicyCard
from carecontact.interface.robot import ActionBounds
from carecontact.protocol.protocol import TrialSpec
from carecontact.recording.reason import TRACEBACK, reason, remedies
from carecontact.running.check_answers import CheckFinding, Level, look_at
from carecontact.serving.conversation import BUDGET_S, PolicyConversation, PolicySetup
from carecontact.serving.opening import open_policy

if TYPE_CHECKING:
    from carecontact.running.check_server import ServerCheck

TOPICS = {"handshake": "card", "action": "answer", "timeout": "slow answer", "start": "import"}
"""Kind of a policy's failure -> topic, where the kind itself would not do."""
CARD = re.compile(r"[\w.]*ContractError: (PolicyCard\..*)")
"""The reason of a card that was refused where the policy made it."""
FRAME = re.compile(r'File "([^"]+)", line (\d+)')


@dataclass(kw_only=True)
class Check:
    spec: TrialSpec
    policy: PolicySetup
    on_finding: Callable[[CheckFinding], None]
    weights: Path | None = None
    pictures: Path | None = None
    """File into which the pictures that are sent are written, for the deep check (``running.check_server``); None:
    without it."""
    warnings: int = 0
    times: dict[str, float] = field(default_factory=dict[str, float])

    def run(self) -> bool:
        conversation, deep = self._opened(), self._deep()
        if deep is not None:
            deep.before()
            deep.listen(conversation)
        spec, seen = self.spec, None
        # The world is built while the policy loads.
        with conversation, ThreadPoolExecutor(1) as building:
            world = building.submit(settled_world, spec.protocol, task_id=spec.task_id, seed=spec.seed)
            try:
                with self._timed("start"):
                    card = conversation.start()
                seeing = (
                    f"{', '.join(card.modalities)} of {', '.join(card.cameras)}" if card.modalities else "no images"
                )
                text = f"{card.name}: {seeing}, {card.action_space} at {card.control_hz:g} Hz"
                self._say("ok", "card", f"{text}; started in {self.times['start']:.2f} s")
                if deep is not None:
                    deep.greeted(card)
                with Episode(spec, card=card, prepare=lambda _: world.result(), weights=self.weights) as episode:
                    seen = episode.reset()
                    return self._converse(conversation, episode, card, seen, deep)
            except PolicyError as error:
                if deep is not None:
                    deep.refused(seen)
                self._fail(error)
                return False

    def _opened(self) -> PolicyConversation:
        phases = self.spec.protocol.phases
        conversation = open_policy(
            self.policy, first_deadline_s=phases.first_call_deadline_s, deadline_s=phases.call_deadline_s
        )
        conversation.on_wait = lambda line: self._say("wait", "", line)
        return conversation

    def _deep(self) -> ServerCheck | None:
        if self.pictures is None:
            return None
        # Imported where it is needed: it brings Pillow and SciPy.
        from carecontact.running.check_server import ServerCheck

        return ServerCheck(
            spec=self.spec, policy=self.policy, pictures=self.pictures, on_finding=self._report, reopen=self._opened
        )

    def _fail(self, error: PolicyError) -> None:
        topic = "connection" if self.policy.ref.kind == "remote" and error.kind == "start" else error.kind
        why, whole = reason(str(error)), str(error)
        first, *more = whole.splitlines() or [whole]
        # The rest says more than its reason if it holds a frame of the policy's, or what the policy printed.
        says_more = len([line for line in more if line != TRACEBACK]) > 1
        text = whole if why in first else f"{why}\n{whole}" if says_more else why
        if wrong := CARD.match(why):
            # The message says all; of the traceback, the place where the card is made is enough.
            (*_, (file, line)) = FRAME.findall(whole) or [("", "")]
            text = f"{wrong[1]} ({file}, line {line})" if file else wrong[1]
        self._say("error", TOPICS.get(topic, topic), text)
        for remedy in remedies(whole):
            self._say("hint", "", remedy)

    def _converse(
        self,
        policy: PolicyConversation,
        episode: Episode,
        card: PolicyCard,
        observation: Observation,
        deep: ServerCheck | None,
    ) -> bool:
        with self._timed("reset"):
            policy.reset(episode.instruction, episode.session)
        self._say("ok", "reset", f"ready after {self.times['reset']:.2f} s")
        answers: list[list[Action]] = []
        for name in ("first", "second"):
            with self._timed(name):
                answers.append(policy.act(observation).actions)
            for number, action in enumerate(answers[-1]):
                try:
                    episode.check(action)
                except ActionError as error:
                    policy.refuse(number, error)
        outside = [action for action in answers[0] if episode.check(action)[1]]
        seconds = len(answers[0]) / card.control_hz
        count = f"{counted(len(answers[0]), 'action')} for {seconds:.2f} s"
        took = f"first call {self.times['first']:.2f} s, second call {self.times['second']:.2f} s"
        self._say("ok", "answer", f"{count}; {took}")
        if outside:
            place = "bounds of the convention" if card.delta else "workspace"
            place = "joint limits" if episode.space.in_joints else place
            many = f"{len(outside)} of {len(answers[0])} targets are outside the {place}"
            text = f"{many}; the card requests that they are moved onto its border"
            self._say("warning", "clipped", f"{text}{_unit(outside[0], episode.session.action_bounds)}")
        for finding in look_at(answers[0], observation):
            self._report(finding)
        if deep is not None:
            deep.answered(answers[1], observation)
        if not self._keeps_pace(len(answers[1]), card):
            return False
        if deep is not None:
            deep.ask_again(policy, observation, episode)
        return True

    def _keeps_pace(self, count: int, card: PolicyCard) -> bool:
        """Whether a trial with answers of this latency fits its budget of wall time."""
        seconds, took = count / card.control_hz, self.times["second"]
        limit_s = self.spec.protocol.phases.time_limit_s
        whole_s = took * limit_s / seconds
        if whole_s > BUDGET_S:
            text = f"a trial of {limit_s:g} s would take {whole_s:.0f} s of the policy's time, {BUDGET_S:g} s are"
            self._say("error", "slow answer", f"{text} allowed: answer with more actions at a time, or faster")
            return False
        if took > seconds:
            text = f"{took:.2f} s for {seconds:.2f} s of motion: a real robot would wait, and a trial of {limit_s:g} s"
            self._say("warning", "slow answer", f"{text} may take {whole_s:.0f} s longer")
        return True

    def _say(self, level: Level, topic: str, text: str) -> None:
        self._report(CheckFinding(level, topic, text))

    def _report(self, finding: CheckFinding) -> None:
        self.warnings += finding.level == "warning"
        self.on_finding(finding)

    @contextmanager
    def _timed(self, name: str) -> Iterator[None]:
        started = time.monotonic()
        yield
        self.times[name] = time.monotonic() - started


def _unit(outside: Action, bounds: ActionBounds) -> str:
    if outside.pose_tcp_in_base is None:
        return ""
    position = np.asarray(outside.pose_tcp_in_base)[:3]
    meant = looks_like_millimetres(position, np.array(bounds.workspace_low_m), np.array(bounds.workspace_high_m))
    return f"; the first of them {meant}" if meant else ""

"""A trial whose worker died: what is known of it, and the recording of its failure.

Nothing tells who sent SIGKILL: the kernel without memory, an operator, or the policy itself; nor who started so many
processes that the trial could start none. Therefore such a trial is repeated; but if the policy may have caused it, the
repetition counts only if the policy answers as it did before, up to the answer at which the lost attempt ended. The
simulation then is where it was, so that a policy which kills itself, to avoid a bad end, gets to the same place again
and has learnt nothing on the way that it did not know.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from carecontact.errors import RecordingError
from carecontact.interface.action import Action
from carecontact.protocol.protocol import TrialSpec
from carecontact.recording import read_recording
from carecontact.recording.provenance import DECLARED, trial_versions
from carecontact.recording.reason import reason_of
from carecontact.recording.schema import (
    EXHAUSTED,
    KILLED,
    POLICY_KILLED,
    SEGMENTS,
    EndReason,
    Failure,
    Header,
    Recording,
    empty_arrays,
)
from carecontact.serving.codec import plain_actions
from carecontact.serving.conversation import PolicySetup
from carecontact.serving.fence import closes_signals
from carecontact.serving.packing import pack

EVIDENCE_CHARACTERS = 4000
"""Length of the tail of a traceback or of stderr kept in a recording; the whole is in the trial's log."""
STORED = "wall/answers"
"""Array of a lost trial's recording: the digests of the answers that a repetition has to begin with, one after
another."""
OTHER_ANSWERS = "other_answers"
"""Kind of the failure of a trial that was lost, and in which the policy then answered differently."""


def harness_error_recording(
    spec: TrialSpec, *, kind: str, message: str, ended: EndReason = "harness_error"
) -> Recording:
    """Return a zero-length recording with the evidence, which counts neither for nor against the policy."""
    half_yaw, regions = math.radians(spec.protocol.scene.robot_yaw_deg) / 2, list(spec.protocol.regions)
    header = Header(
        spec=spec,
        ended=ended,
        failure=Failure(kind=kind, message=message),
        card=None,
        embodiment="none",
        comfort_arm_deg=None,
        segments=list(SEGMENTS),
        regions=regions,
        human_joints=[],
        pose_base_in_world=[*spec.protocol.scene.robot_base_m, math.cos(half_yaw), 0.0, 0.0, math.sin(half_yaw)],
        identity=DECLARED,
        versions=trial_versions(spec.protocol),
        sha256={},
        solver_warnings=[],
    )
    return Recording(header=header, arrays=empty_arrays(0, regions=len(regions)))


def tail(text: str, *, characters: int = EVIDENCE_CHARACTERS) -> str:
    if len(text) <= characters:
        return text.strip()
    cut = text[-characters:]
    return "[...] " + cut[cut.find("\n") + 1 :].strip()


def digest_of(actions: Sequence[Action]) -> bytes:
    return hashlib.sha256(pack(plain_actions(actions))).digest()


@dataclass(frozen=True, kw_only=True)
class Lost:
    answers: bytes = b""
    """Digests of the answers that a repetition has to begin with."""
    recording: Recording | None = None
    """Recording of the attempt that gave these answers; None if its process left no recording."""

    def permits(self, answers: bytes) -> bool:
        """Whether a repetition that gave these answers went the same way, as far as both went."""
        return answers.startswith(self.answers) or self.answers.startswith(answers)

    def answered_otherwise(self, spec: TrialSpec) -> Recording:
        """Return the recording of a trial whose repetition does not count: that of the attempt before it."""
        message = (
            "a process of this trial was killed by a signal or could not be started, and in the repetition the policy "
            "gave other answers than before; a repetition counts only if it goes the same way as the attempt that was "
            "lost"
        )
        recording = self.recording or harness_error_recording(
            spec, kind=POLICY_KILLED, message=message, ended="process_failure"
        )
        failure = Failure(kind=OTHER_ANSWERS, message=message)
        return replace(recording, header=recording.header.model_copy(update={"failure": failure}))


def is_policy_killed(header: Header) -> bool:
    """Whether the trial ended because its policy's process was killed, or because its own was while the policy ran."""
    return header.ended == "process_failure" and header.failure is not None and header.failure.kind == POLICY_KILLED


def lack_in(header: Header) -> str:
    """Return why the trial ended if its own process got no further process, thread or memory; else an empty text."""
    failure = header.failure
    if header.ended == "harness_error" and failure is not None and failure.kind == EXHAUSTED:
        return failure.message.partition("\n")[0]
    return ""


class Losses:
    """What a command does about lost trials: each is run once more, and is recorded as lost if that is lost too.

    Methods return the recording that the trial gets, or the reason to run it once more.
    """

    def __init__(self, policy: PolicySetup, *, out: Path, before: Iterable[str]) -> None:
        """``before``: trials in ``out`` that earlier commands lost."""
        self._lost: dict[str, Lost] = {}
        self._again = set[str]()
        self._signals_closed = policy.ref.kind == "remote" or (policy.isolated and closes_signals())
        """Whether the policy has no means to send the trial's process a signal."""
        for trial_id in before:
            with suppress(RecordingError):
                recording = read_recording(out / f"{trial_id}.h5")
                if STORED in recording.arrays:
                    kept = recording if is_policy_killed(recording.header) else None
                    self._lost[trial_id] = Lost(answers=recording[STORED].tobytes(), recording=kept)

    def ended(self, recording: Recording, answers: bytes) -> Recording | str:
        """Handle a trial that left a recording; its policy's process may have been killed."""
        spec, failure = recording.header.spec, recording.header.failure
        if failure is not None and is_policy_killed(recording.header):
            return self._once_more(spec, answers, reason_of(failure), of_policy=recording, otherwise=recording)
        earlier = self._lost.get(spec.trial_id, Lost())
        return recording if earlier.permits(answers) else earlier.answered_otherwise(spec)

    def died(
        self, spec: TrialSpec, answers: bytes, death: str, evidence: str, *, with_policy: bool, starved: bool
    ) -> Recording | str:
        """Handle a trial whose own process died. Chance, such as a machine out of memory, seldom comes twice at the
        same place; a policy that kills does, and must not leave its bad trials out of the count.

        ``with_policy``: whether its policy was running. ``starved``: whether it ran out of time, processes or memory,
        to which any policy of this machine can bring it.
        """
        if with_policy:
            death += " while the policy was running"
            # A trial whose process dies whenever its policy runs is a failure of the policy.
            message, kind, ended = f"{death}, in both attempts{evidence}", POLICY_KILLED, "process_failure"
            failed = harness_error_recording(spec, kind=kind, message=message, ended=ended)
        else:
            failed = harness_error_recording(spec, kind=KILLED, message=death + evidence)
        bound = b"" if self._signals_closed and not starved else answers
        return self._once_more(spec, bound, death, otherwise=failed)

    def _once_more(
        self, spec: TrialSpec, answers: bytes, why: str, *, otherwise: Recording, of_policy: Recording | None = None
    ) -> Recording | str:
        earlier = self._lost.get(spec.trial_id, Lost())
        if not earlier.permits(answers):
            return earlier.answered_otherwise(spec)
        further = len(answers) >= len(earlier.answers)
        left = Lost(answers=answers, recording=of_policy) if further else earlier
        self._lost[spec.trial_id] = left
        if spec.trial_id not in self._again:
            self._again.add(spec.trial_id)
            return why
        recording = left.recording or otherwise
        return replace(recording, arrays={**recording.arrays, STORED: np.frombuffer(left.answers, "u1")})

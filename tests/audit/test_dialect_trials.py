"""Trials with a server of each dialect under audit: messages are made again without a simulator and a server."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from carecontact.audit.derivation import audit_derivation
from carecontact.audit.keyframe import Keyframe
from carecontact.audit.schema import audit_schema
from carecontact.audit.watched import Watched, watch
from carecontact.contract.trial import TrialSpec
from carecontact.hosting.dialects import openpi
from tests.audit.conftest import places
from tests.audit.test_dialects import SERVERS, also
from tests.audit.test_planted_leaks import short


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

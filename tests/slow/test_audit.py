"""The whole audit: every region, every card of its own, the policies' trials to their end."""

from __future__ import annotations

import pytest

from carecontact.audit.run import audit
from carecontact.policies.registry import POLICIES
from carecontact.protocols import load_protocol

pytestmark = pytest.mark.slow


def test_no_part_finds_a_leak() -> None:
    result = audit(load_protocol(), tuple(POLICIES), quick=False)
    assert [(part.name, part.findings, part.missing) for part in result.parts if not part.passed] == []
    counts = {part.name: part.counts for part in result.parts}
    assert counts["re-derivation"]["observations in contact"] >= 3 * 4 * 3

from __future__ import annotations

from carecontact.recording.remedies import remedies


def test_a_refusal_has_its_remedy_and_other_failures_none() -> None:
    message = "policy 'x' failed at act: actions[0].pose_tcp_in_base: expected finite numbers, got [nan]"
    assert remedies(message) == ["Look for a division by 0 or an unset value in the policy's output."]
    assert remedies(f"{message}, which looks like nothing that was ever set") == []
    assert remedies("policy 'x' failed at act: its process was killed by SIGKILL without an answer") == []

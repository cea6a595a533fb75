"""What may help after an answer of a policy was refused."""

from __future__ import annotations

REMEDIES = {
    "expected a position inside the workspace": "Check frame (base of the robot) and unit (metres). A card with "
    "out_of_bounds clip has such targets moved onto the border.",
    "expected finite numbers": "Look for a division by 0 or an unset value in the policy's output.",
    "expected a quaternion of norm 1": "Divide the quaternion by its norm; its order is w x y z.",
}
"""Part of a refusal -> what may help."""
LOOKS = "looks like"


def remedies(message: str) -> list[str]:
    """Return a sentence for each refusal of REMEDIES that the message of a failure names; mostly none.

    A refusal that says itself what the answer looks like needs none.
    """
    if LOOKS in message:
        return []
    return [remedy for part, remedy in REMEDIES.items() if part in message]

"""What may help after an answer of a policy was refused."""

from __future__ import annotations

from carecontact.contract.policy import CAMERAS

CAMERA = "The card's cameras say which cameras an observation has, if its modalities name anything."
REMEDIES = {
    "expected a position inside the workspace": "Check frame (base of the robot) and unit (metres). A card with "
    "out_of_bounds clip has such targets moved onto the border.",
    "expected finite numbers": "Look for a division by 0 or an unset value in the policy's output.",
    "expected a quaternion of norm 1": "Divide the quaternion by its norm; its order is w x y z. Angles have to be "
    "turned into a quaternion first.",
    "did not receive a valid HTTP response": "What listens there is no WebSocket server.",
    **{f"KeyError: '{camera}'": CAMERA for camera in CAMERAS},
    "'NoneType' object is not subscriptable": "A field of a camera's view is None unless the card's modalities name "
    "it; landmarks_in_base needs depth, too.",
    "'Observation' object is not subscriptable": "An observation has attributes, as in "
    "observation.cameras['overhead'].rgb.",
    "Action.__init__() got an unexpected keyword argument": "docs/wire.md lists the fields of an Action under actions; "
    "a pose is pose_tcp_in_base.",
    "reset() takes 1 positional argument but 2 were given": "reset receives the instruction: write def reset(self, "
    "instruction).",
    "got coroutine": "The methods of a policy are plain functions: write def act, and not async def act.",
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

"""Makes and reads the messages of every dialect again, for an audit that has a card's arguments but no server."""

from __future__ import annotations

from collections.abc import Mapping

from carecontact.interface.observation import Observation
from carecontact.serving import openpi, packing, vla_eval
from carecontact.serving.codec import act_message
from carecontact.serving.dialect import SESSION, profile_of
from carecontact.serving.openpi import infer_request


def dialect_of(arguments: Mapping[str, str]) -> str:
    """Return ``openpi``, ``roboarena`` or ``vla-eval``; empty for a card of the native wire."""
    return arguments.get("dialect", "")


def unpacked_message(message: bytes, dialect: str) -> object:
    """Decode a message of a dialect. Raises ContractError if it is none."""
    return (openpi if dialect in ("openpi", "roboarena") else packing).unpack(message)


def rebuilt_message(
    observation: Observation, arguments: Mapping[str, str], cameras: tuple[str, ...], *, sent: bytes
) -> bytes:
    """Make the message that carries an observation again.

    Args:
        arguments, cameras: those of the policy's card.
        sent: the message as it was sent; its random session id and its number in the connection are reused.

    Raises ContractError if ``sent`` is no message of the dialect, or the observation does not fit the card.
    """
    dialect = dialect_of(arguments)
    if not dialect:
        return act_message(observation)
    was = unpacked_message(sent, dialect)
    known = was if packing.is_map(was) else {}
    if dialect == "vla-eval":
        payload = vla_eval.observation_payload(observation, cameras, arguments)
        seq = known.get("seq")
        return vla_eval.message("observation", payload, seq=seq if isinstance(seq, int) else 0)
    session_id = str(known.get(SESSION, ""))
    return openpi.pack(infer_request(observation, profile_of(arguments), session_id=session_id))

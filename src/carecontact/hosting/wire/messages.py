"""The messages that the harness sends."""

from __future__ import annotations

import hashlib

from carecontact.contract.observation import Observation
from carecontact.contract.session import Session
from carecontact.hosting.wire import codec
from carecontact.hosting.wire.packing import pack

CLOSE = pack({"type": "close"})


def reset_message(instruction: str, session: Session) -> bytes:
    return pack({"type": "reset", "instruction": instruction, "session": codec.encode_session(session)})


def act_message(observation: Observation) -> bytes:
    """Return the message that carries an observation. Raises ObservationError if the observation breaks the
    contract.
    """
    return pack({"type": "act", "observation": codec.encode_observation(observation)})


def observation_sha256(observation: Observation) -> bytes:
    """Return the digest, 32 bytes, of the message that carries an observation, as recordings keep it.

    Give it to ``Episode`` as ``digest``, so that a loop of your own makes the recording that a trial would make.
    """
    return hashlib.sha256(act_message(observation)).digest()

"""The client of the servers of openpi, RoboArena and vllm-omni. They share one wire format and differ in what they send
first.

A server sends its metadata as soon as the connection is open. Those of openpi are empty or describe no action space, so
that the address has to name a profile; those of RoboArena and vllm-omni describe what the server needs. After that,
every request is one map and its answer one frame. An error is a text frame (openpi, RoboArena) or ``{"type": "error"}``
(vllm-omni).
"""

from __future__ import annotations

from collections.abc import Mapping

from carecontact.contract.observation import Observation
from carecontact.contract.policy import PolicyCard
from carecontact.contract.session import Session
from carecontact.errors import ActionError, ContractError, PolicyError
from carecontact.hosting.client import ActReply, Client, sha256
from carecontact.hosting.dialects.chunks import joint_actions
from carecontact.hosting.dialects.packing_openpi import pack, unpack
from carecontact.hosting.dialects.profiles import (
    PROFILES,
    SESSION,
    Profile,
    card_of,
    contradiction,
    describes_itself,
    fitting,
    named_profile,
    told_profile,
)
from carecontact.hosting.dialects.requests import infer_request, new_session_id, reset_request
from carecontact.hosting.wire.connection import Connection
from carecontact.hosting.wire.packing import is_array, is_map

LATE = "; an openpi server sends its metadata first, unasked; other servers need another scheme in the address"
PACKED = "send one binary message, packed as openpi_client.msgpack_numpy does"
ERROR_WORDS = ("Traceback", "Error")
"""If a text that answers a reset begins so, it is an error and no confirmation."""


class OpenpiClient(Client):
    """One trial with a server of the openpi family."""

    def __init__(self, connection: Connection, *, scheme: str, options: Mapping[str, str]) -> None:
        """
        Args:
            scheme: ``openpi`` or ``roboarena``.
            options: the options in the server's address.
        """
        super().__init__(connection)
        self._scheme, self._options = scheme, dict(options)
        self._session_id = new_session_id()
        self._profile: Profile | None = None

    def card(self, *, deadline_s: float) -> PolicyCard:
        """Receive the metadata and return the card.

        Raises PolicyError ``handshake`` if the metadata and the address together do not determine a profile.
        """
        frame = self.connection.receive("metadata", deadline_s=deadline_s, late=LATE)
        metadata = _decoded(frame, "metadata")
        if not is_map(metadata):
            raise PolicyError("handshake", f"metadata: expected a map, got {_shown(metadata)}; {PACKED}")
        self._profile = self._chosen(metadata)
        told = self._profile.endpoint
        return card_of(self._profile, dialect="roboarena" if told else "openpi")

    def _chosen(self, metadata: Mapping[str, object]) -> Profile:
        if "profile" not in self._options:
            if self._scheme == "openpi" and not describes_itself(metadata):
                keys = f"only {', '.join(sorted(metadata)):.200}" if metadata else "nothing"
                raise PolicyError(
                    "handshake",
                    f"the server says {keys} of itself: neither action space nor pictures. Name the profile that "
                    f"it was trained for in the address: ?profile={' or ?profile='.join(PROFILES)}",
                )
            if "horizon" in self._options:
                raise PolicyError(
                    "handshake",
                    "horizon: a server that describes itself has all its actions executed; leave horizon out, or name "
                    "a profile",
                )
            return told_profile(metadata, self._options)
        profile = named_profile(self._options)
        if wrong := contradiction(profile, metadata):
            raise PolicyError("handshake", f"{wrong}; {fitting(metadata)}")
        return profile

    def _begin(self, instruction: str, session: Session, *, deadline_s: float) -> None:
        """Ask for a reset. openpi's servers have none; the others then forget what they keep of the session."""
        if self._known.endpoint:
            frame = self.connection.ask(pack(reset_request(self._session_id)), "reset", deadline_s=deadline_s)
            _confirmed(frame)

    def _act(self, observation: Observation, *, deadline_s: float) -> ActReply:
        profile = self._known
        request = infer_request(observation, profile, session_id=self._session_id)
        message = pack(request)
        answer = _decoded(self.connection.ask(message, "actions", deadline_s=deadline_s), "actions")
        try:
            actions = joint_actions(
                _chunk(answer, single=profile.endpoint), horizon=profile.horizon, space=profile.action_space
            )
        except ActionError as error:
            raise PolicyError("action", str(error)) from None
        return ActReply(actions=actions, sent=message, sent_sha256=digest(request))

    def _end(self, *, deadline_s: float) -> None:
        """Tell the server that the session has ended, so that it can forget it; no answer is needed."""
        if self._profile is not None and self._profile.endpoint:
            self.connection.send(pack(reset_request(self._session_id)), deadline_s=deadline_s)

    @property
    def _known(self) -> Profile:
        if self._profile is None:
            raise ContractError("OpenpiClient: expected card before it, got none")
        return self._profile


def digest(request: Mapping[str, object]) -> bytes:
    """Return the digest, 32 bytes, of a request without its random session id, so that equal trials have equal
    digests.
    """
    return sha256(pack({name: value for name, value in request.items() if name != SESSION}))


def _decoded(frame: bytes | str, what: str) -> object:
    """Decode a frame. Raises PolicyError ``exception`` for an error that the server reports, ``garbage`` for any other
    frame that is no message.
    """
    if isinstance(frame, str):
        raise PolicyError("exception", _told(frame))
    try:
        message = unpack(frame)
    except ContractError as error:
        raise PolicyError("garbage", f"{what} {error}; {PACKED}") from None
    if is_map(message) and message.get("type") == "error":
        raise PolicyError("exception", _told(message.get("message")))
    return message


def _told(error: object) -> str:
    if isinstance(error, str) and error.strip():
        return error
    return f"the policy's server reported an error, expected its reason as text, got {error!r:.80}"


def _confirmed(frame: bytes | str) -> None:
    """Check the answer to a reset: RoboArena confirms it with a text, vllm-omni with a map."""
    answer = frame if isinstance(frame, str) else _decoded(frame, "reset")
    if isinstance(answer, str):
        if not answer.strip() or answer.lstrip().startswith(ERROR_WORDS):
            raise PolicyError("exception", _told(answer))
    elif not is_map(answer) or "status" not in answer:
        raise PolicyError("garbage", f"reset: expected a text or a map with status, got {_shown(answer)}")


def _chunk(answer: object, *, single: bool) -> object:
    """Return the array of actions in an answer. Raises PolicyError ``garbage`` if there is none.

    ``single``: whether an array with one axis counts as one action, as for RoboArena's client.
    """
    if is_map(answer):
        if "actions" not in answer:
            keys = ", ".join(sorted(answer)) or "none"
            raise PolicyError("garbage", f"expected a map with the key actions, got the keys {keys:.200}; {PACKED}")
        answer = answer["actions"]
    elif not is_array(answer):
        raise PolicyError("garbage", f"expected actions in a map or an array, got {_shown(answer)}; {PACKED}")
    return answer[None] if single and is_array(answer) and answer.ndim == 1 else answer


def _shown(value: object) -> str:
    return f"an array {value.dtype} {value.shape}" if is_array(value) else f"{type(value).__name__} {value!r:.80}"

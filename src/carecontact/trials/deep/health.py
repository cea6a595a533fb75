"""Asks a server whether it is healthy, at the address that its kind offers for this."""

from __future__ import annotations

from http.client import HTTPConnection, HTTPException

from carecontact.contract.policy_ref import PolicyRef
from carecontact.hosting.conversation import readable
from carecontact.trials.finding import Finding

PATHS = {"openpi": ("/healthz",), "roboarena": ("/healthz", "/health"), "vla-eval": ("/health",)}
"""Scheme -> paths at which its servers answer a plain HTTP request. RoboArena's servers copy openpi's; vllm-omni has
/health."""
DEADLINE_S = 5.0
SHOWN_BYTES = 200


def health(ref: PolicyRef) -> Finding | None:
    """Ask a remote policy's server; return None for a kind of server without such an address.

    It is no fault if a server lacks the address. Nor is it if a server does not listen: the connection will show that.
    """
    for path in PATHS.get(ref.scheme, ()):
        try:
            status, text = _get(ref, path)
        except (OSError, HTTPException, ValueError):
            continue
        if status == 200:
            return Finding(level="ok", topic="health", text=f"{path} answers {text or 'with no text'}")
        if status >= 500:
            return Finding(level="warning", topic="health", text=f"{path} answers HTTP {status} {text}")
    return None


def _get(ref: PolicyRef, path: str) -> tuple[int, str]:
    # http.client uses no proxy of the environment.
    connection = HTTPConnection(ref.host, ref.port, timeout=DEADLINE_S)
    try:
        connection.request("GET", path)
        response = connection.getresponse()
        return response.status, readable(" ".join(response.read(SHOWN_BYTES).decode(errors="replace").split()))
    finally:
        connection.close()

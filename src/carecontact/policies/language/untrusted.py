"""Makes what an endpoint says fit to be stored and printed: without the run's secrets, printable and short."""

from __future__ import annotations

import base64
import html
import json
import re
from collections.abc import Iterable, Iterator
from urllib.parse import quote, quote_plus

SHORTEST_SECRET = 6
"""Length [characters] from which a secret is looked for. A shorter one (``none``, ``test``) is a placeholder, and would
be found in ordinary words."""
SHORTEST_BASE64 = 8
REMOVED = "[secret removed]"
CUT = " [...]"


class Cleaner:
    """Removes secrets from what one endpoint says.

    This helps against endpoints that repeat what they were sent. One that means to give a secret away can always spell
    it in a way that is not known here.
    """

    def __init__(self, secrets: Iterable[str] = ()) -> None:
        """``secrets``: values to remove; those of fewer than SHORTEST_SECRET characters stay."""
        spelled = {s for secret in secrets if len(secret) >= SHORTEST_SECRET for s in _spellings(secret)}
        longest_first = sorted(spelled, key=lambda s: (-len(s), s))
        self._secrets = re.compile("|".join(map(re.escape, longest_first)), re.IGNORECASE) if spelled else None

    def text(self, said: str) -> str:
        """Return a text of any length with its line ends and tabs; other control characters become U+FFFD."""
        said = self._without_secrets(said)
        return "".join("\ufffd" if _is_control(c) else c for c in said)

    def line(self, said: str, *, limit: int) -> str:
        """Return what ``one_line`` does, without secrets."""
        # Secrets are removed first, because the first half of a key that is cut in two would stay.
        return one_line(self._without_secrets(said), limit=limit)

    def _without_secrets(self, said: str) -> str:
        return said if self._secrets is None else self._secrets.sub(REMOVED, said)


def one_line(said: str, *, limit: int) -> str:
    """Return one line of at most ``limit`` characters; what is not printable is escaped, and a cut is marked."""
    said = " ".join(said.split())[: limit + 1]
    said = "".join(c if c.isprintable() else ascii(c)[1:-1] for c in said)
    return said if len(said) <= limit else said[: limit - len(CUT)] + CUT


def _is_control(c: str) -> bool:
    return (c < " " and c not in "\n\r\t") or "\x7f" <= c <= "\x9f"


def _spellings(secret: str) -> Iterator[str]:
    """Yield a secret as it is, and as it looks in JSON, a Python literal, HTML, a URL, and base64 of a longer text."""
    yield secret
    yield from (json.dumps(secret)[1:-1], secret.replace("/", "\\/"), repr(secret)[1:-1], html.escape(secret))
    yield from (quote(secret), quote(secret, safe=""), quote_plus(secret))
    for before in range(3):
        # Characters of base64 that depend on what stands beside the secret are left out.
        content = b"\0" * before + secret.encode()
        whole = len(content) * 4 // 3
        for encode in (base64.b64encode, base64.urlsafe_b64encode):
            fragment = encode(content)[:whole].decode()[(0, 2, 3)[before] :]
            if len(fragment) >= SHORTEST_BASE64:
                yield fragment

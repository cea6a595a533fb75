"""Messages of a trial's process to its supervisor, through a pipe, which works even if the disk is full."""

from __future__ import annotations

import os
from contextlib import suppress

POLICY_RUNS, POLICY_GONE, ANSWERED = b"+", b"-", b"="
"""The process of a local policy is about to start; it is gone; it answered, and DIGEST_BYTES follow."""
DIGEST_BYTES = 32


class Told:
    """The supervisor's end of the pipe."""

    def __init__(self, pipe: int) -> None:
        """``pipe``: file descriptor to read from, which this object then owns."""
        os.set_blocking(pipe, False)
        self._pipe = pipe
        self._rest = b""
        self.policy_runs = False
        self.answers = b""
        """Digests of the policy's answers, one after another."""

    def read(self) -> None:
        """Read the messages that have arrived. Call it repeatedly: the other end waits while the pipe is full."""
        with suppress(BlockingIOError):
            while piece := os.read(self._pipe, 1 << 16):
                self._rest += piece
        while self._rest:
            kind, size = self._rest[:1], 1
            if kind == ANSWERED:
                size += DIGEST_BYTES
                if len(self._rest) < size:
                    return
                self.answers += self._rest[1:size]
            else:
                self.policy_runs = kind == POLICY_RUNS
            self._rest = self._rest[size:]

    def close(self) -> None:
        os.close(self._pipe)

"""Sampling parameters as an endpoint accepts them: OpenAI's newer models take other names than most endpoints."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace

from carecontact.policies.language.completion import CompletionRequest


@dataclass(frozen=True, kw_only=True)
class Sampling:
    """Which parameters are sent."""

    temperature: bool = True
    """False if the endpoint accepts none; it then samples as it does by default."""
    limit: str = "max_tokens"
    """Name of the token limit; the newer one, ``max_completion_tokens``, also counts a model's reasoning."""

    def parameters(self, request: CompletionRequest) -> dict[str, float | int]:
        """Return the parameters to send with a request."""
        sent: dict[str, float | int] = {self.limit: request.max_tokens}
        return {"temperature": request.temperature, **sent} if self.temperature else sent

    def adapted(self, parameter: str | None, message: str) -> Sampling:
        """Return what to send after an HTTP 400: what the error names is left out or replaced.

        Args:
            parameter: the error's own field for the name of a parameter. Where it is None, the name is looked for in
                ``message``.
            message: the error's text.
        """
        named = {parameter} if parameter else set(re.findall(r"\b(?:temperature|max_tokens)\b", message))
        changed = self
        if "temperature" in named:
            changed = replace(changed, temperature=False)
        if "max_tokens" in named:
            changed = replace(changed, limit="max_completion_tokens")
        return changed

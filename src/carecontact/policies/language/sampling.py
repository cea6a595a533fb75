"""Sampling parameters in the spelling that an endpoint takes: those of OpenAI's newer models are not everyone's."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace

from carecontact.policies.language.completion import CompletionRequest


@dataclass(frozen=True, kw_only=True)
class Sampling:
    temperature: bool = True
    """False: the endpoint takes none, and samples as it does by default."""
    limit: str = "max_tokens"
    """Name of the token limit; the newer one, ``max_completion_tokens``, also counts what a model thinks."""

    def parameters(self, request: CompletionRequest) -> dict[str, float | int]:
        sent: dict[str, float | int] = {self.limit: request.max_tokens}
        return {"temperature": request.temperature, **sent} if self.temperature else sent

    def adapted(self, parameter: str | None, message: str) -> Sampling:
        """After an HTTP 400: without the temperature, or with the newer limit, if the error names them; else as it is.

        ``parameter``: the error's own field for the name; where an endpoint has none, the name is looked for in
        ``message``.
        """
        named = {parameter} if parameter else set(re.findall(r"\b(?:temperature|max_tokens)\b", message))
        changed = self
        if "temperature" in named:
            changed = replace(changed, temperature=False)
        if "max_tokens" in named:
            changed = replace(changed, limit="max_completion_tokens")
        return changed

"""Programs by language model: from a query to a program, asked once and kept."""

from __future__ import annotations

from carecontact.errors import LanguageError
from carecontact.policies.language.completion import Message
from carecontact.policies.language.fence import unfenced
from carecontact.policies.language.transcript import Transcript
from carecontact.policies.voxposer.prompts import PromptSet


class Programs:
    """Written on demand; the same query is never asked twice."""

    def __init__(self, transcript: Transcript, prompts: PromptSet) -> None:
        self._transcript, self._prompts = transcript, prompts
        self._written: dict[tuple[str, str], str] = {}

    def program(self, role: str, query: str) -> str:
        """``role``: one of the prompts. Raises LanguageError."""
        key = (role, query)
        if key not in self._written:
            messages = [
                Message(role="system", content=self._prompts.system(role)),
                Message(role="user", content=self._prompts.user(query)),
            ]
            text = self._transcript.text(messages, purpose=f"{role}: {query}", prompt_version=self._prompts.version)
            self._written[key] = unfenced(text)
            if not self._written[key].strip():
                raise LanguageError(f"{self._transcript.name}: the answer to {role}: {query} holds no program")
        return self._written[key]

    def take_calls(self) -> list[dict[str, object]]:
        return self._transcript.take_calls()

    @property
    def written(self) -> list[dict[str, str]]:
        return [{"role": role, "query": query, "code": code} for (role, query), code in self._written.items()]

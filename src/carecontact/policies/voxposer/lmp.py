"""Asks a language model for the program that answers a query."""

from __future__ import annotations

from carecontact.errors import LanguageError
from carecontact.policies.language.completion import Message
from carecontact.policies.language.fence import unfenced
from carecontact.policies.language.transcript import Transcript
from carecontact.policies.voxposer.prompts import PromptSet


class Programs:
    """Requests programs on demand; the same query is never sent twice."""

    def __init__(self, transcript: Transcript, prompts: PromptSet) -> None:
        self._transcript, self._prompts = transcript, prompts
        self._written: dict[tuple[str, str], str] = {}

    def program(self, role: str, query: str) -> str:
        """Return the program for a query to ``role``, which is one of the prompts.

        Raises LanguageError if the language model gives none.
        """
        key = (role, query)
        if key not in self._written:
            messages = [
                Message(role="system", content=self._prompts.system(role)),
                Message(role="user", content=self._prompts.user(query)),
            ]
            text = self._transcript.text(messages, purpose=f"{role}: {query}", prompt_version=self._prompts.version)
            self._written[key] = unfenced(text)
            if not self._written[key].strip():
                raise LanguageError(f"{self._transcript.name}: the answer to {role}: {query} contains no program")
        return self._written[key]

    def take_calls(self) -> list[dict[str, object]]:
        """Return the calls to the language model since the last time, for the recording."""
        return self._transcript.take_calls()

    @property
    def written(self) -> list[dict[str, str]]:
        """Every program with its role and query, in the order in which they were requested."""
        return [{"role": role, "query": query, "code": code} for (role, query), code in self._written.items()]

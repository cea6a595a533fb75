from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from carecontact.policies.language.completion import (
    MAX_TOKENS,
    Completion,
    CompletionRequest,
    Message,
    Transcript,
    append_completion,
)
from carecontact.policies.voxposer.maps import Grid
from carecontact.policies.voxposer.programs import VOXPOSER, PromptSet
from carecontact.policies.voxposer.sandbox import Sandbox


@pytest.fixture
def grid() -> Grid:
    return Grid(low_m=np.array([0.0, -0.6, 0.0]), high_m=np.array([0.99, 0.588, 0.7425]))


@pytest.fixture(scope="session")
def sandbox() -> Iterator[Sandbox]:
    box = Sandbox()
    yield box
    box.close()


class Scripted:
    """A source of completions with a program for each role and query; ``*`` for any query."""

    name, model = "replay:test:authored", "authored"

    def __init__(self, programs: dict[tuple[str, str], str], prompts: PromptSet = VOXPOSER) -> None:
        self.programs = programs
        self.roles = {prompts.roles[role]: role for role in prompts.roles}

    def complete(self, request: CompletionRequest) -> Completion:
        role, query = self.roles[request.messages[0].content], request.messages[1].content
        code = self.programs.get((role, query), self.programs.get((role, "*")))
        assert code is not None, (role, query)
        return Completion(text=code, model="authored")


def scripted(programs: dict[tuple[str, str], str], prompts: PromptSet = VOXPOSER) -> Transcript:
    return Transcript(Scripted(programs, prompts))


@pytest.fixture
def replay_file(tmp_path: Path) -> Callable[[dict[tuple[str, str], str]], Path]:
    """A replay file that answers voxposer's prompts with these programs."""

    def write(programs: dict[tuple[str, str], str]) -> Path:
        path = tmp_path / "programs.jsonl"
        for (role, query), code in programs.items():
            messages = (Message(role="system", content=VOXPOSER.roles[role]), Message(role="user", content=query))
            request = CompletionRequest(
                model="authored", max_tokens=MAX_TOKENS, prompt_version=VOXPOSER.version, messages=messages
            )
            append_completion(path, request, Completion(text=code, model="authored"))
        return path

    return write

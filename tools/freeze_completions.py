"""Turn the hand-written programs of a method into a replay file that answers its present prompts.

    python tools/freeze_completions.py

Run it after a prompt or a program changed; it writes the .jsonl and the .sha256 beside every .toml of
src/carecontact/policies/voxposer/completions. A full run names the hash, so nothing may change after one.
"""

from __future__ import annotations

import hashlib
import json
import tomllib
from pathlib import Path

from carecontact.policies.language.completion import (
    AUTHORED,
    MAX_TOKENS,
    Completion,
    CompletionRequest,
    Message,
    RecordedCompletion,
)
from carecontact.policies.voxposer.programs import SETS, PromptSet

FOLDER = Path(__file__).resolve().parents[1] / "src/carecontact/policies/voxposer/completions"


def replay_lines(source: str, prompts: PromptSet) -> str:
    """``source``: TOML with tables ``completion`` of role, query and code."""
    lines = []
    for row in tomllib.loads(source)["completion"]:
        messages = (
            Message(role="system", content=prompts.roles[row["role"]]),
            Message(role="user", content=row["query"]),
        )
        request = CompletionRequest(
            model=AUTHORED, messages=messages, max_tokens=MAX_TOKENS, prompt_version=prompts.version
        )
        recorded = RecordedCompletion(
            key=request.sha256, request=request, completion=Completion(text=row["code"].strip(), model=AUTHORED)
        )
        lines.append(json.dumps(recorded.model_dump(mode="json"), sort_keys=True))
    return "\n".join(lines) + "\n"


def main() -> None:
    for name, prompts in SETS.items():
        content = replay_lines((FOLDER / f"{name}.toml").read_text(), prompts)
        (FOLDER / f"{name}.jsonl").write_text(content)
        digest = hashlib.sha256(content.encode()).hexdigest()
        (FOLDER / f"{name}.sha256").write_text(f"{digest}  {name}.jsonl\n")
        print(f"{name}: {content.count(chr(10))} completions, sha256 {digest[:12]}")


if __name__ == "__main__":
    main()

"""Write the JSON Schema of every line that `--json` prints, from the models in src/carecontact/cli.

python tools/json_schemas.py
"""

from __future__ import annotations

import json
from pathlib import Path

from carecontact.cli.answers import schema_of
from carecontact.cli.result_answers import ANSWERS, name_of

FOLDER = Path(__file__).parents[1] / "src" / "carecontact" / "cli" / "schemas"


def written() -> dict[str, str]:
    """Name of each file -> its content."""
    return {
        f"{name_of(answer)}.json": json.dumps(schema_of(answer), indent=1, sort_keys=True) + "\n" for answer in ANSWERS
    }


def main() -> None:
    FOLDER.mkdir(exist_ok=True)
    for name, text in written().items():
        (FOLDER / name).write_text(text, encoding="utf-8")
        print(FOLDER / name)


if __name__ == "__main__":
    main()

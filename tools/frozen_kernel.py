"""Note that the C sources of the tissue here answer as those did with which the frozen protocols were made.

    python tools/frozen_kernel.py

Plays the script of contacts (``carecontact.kernel.behaviour``) and writes the hash of the sources into
``kernel/frozen.json`` if every answer is equal bit for bit. Otherwise it writes nothing, names the contacts that are
answered otherwise, and ends with status 1. Run it after every change of the C sources, on x86-64.
"""

from __future__ import annotations

import json
import sys

from carecontact.kernel import binary
from carecontact.kernel.behaviour import behaviour, stored
from carecontact.kernel.found import FROZEN


def main() -> int:
    before = stored()
    other = [name for name, answer in behaviour().items() if answer != before[name]]
    if other:
        print(f"answered otherwise than by the frozen kernel: {', '.join(other)}", file=sys.stderr)
        return 1
    content = json.loads(FROZEN.read_text(encoding="ascii"))
    content["person-v1"]["equal_sources"] = binary.sources_sha256()
    FROZEN.write_text(json.dumps(content, indent=1) + "\n", encoding="ascii")
    print(f"{FROZEN}: these sources answer alike")
    return 0


if __name__ == "__main__":
    sys.exit(main())

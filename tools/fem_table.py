"""Write the finite elements' results that a tissue is compared with, into the package.

    .venv/bin/python tools/fem_table.py

takes about two minutes. Run it after a change of the finite elements, of their materials or of the published curves.
"""

from __future__ import annotations

from pathlib import Path

from carecontact.lab import fem
from carecontact.lab.fem.cases import CASES
from carecontact.lab.fem.compare import FILE, as_text, judged


def main() -> None:
    found = {}
    for case in CASES:
        found[case.region] = judged(case)
        print(case.region, flush=True)
    path = Path(fem.__path__[0]) / FILE
    path.write_text(as_text(found))
    print(path)


if __name__ == "__main__":
    main()

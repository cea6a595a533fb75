"""Write the finite elements' results that a tissue is compared with, into the package.

    .venv/bin/python tools/fem_table.py

takes about two minutes. Run it after a change of the finite elements, of their materials or of the published curves.
"""

from __future__ import annotations

import json
from pathlib import Path

from carecontact.lab import fem
from carecontact.lab.fem.cases import CASES, FRICTION, MATCHED_M, POISSON, SKINS, TOUCH_N, Answer
from carecontact.lab.fem.compare import Standard, judged, made, rounded

FILE = Path(fem.__path__[0]) / "standards.json"
SCHEMA = "carecontact-fem-standards-1"


def standards() -> list[Standard]:
    """Return the stored standards, of CASES with their own grounds."""
    stored = json.loads(FILE.read_text())
    return [
        Standard(region=region, name=name, unit=unit, skins=tuple(skins), plain=plain)
        for region, held in stored["regions"].items()
        for name, unit, plain, *skins in held["rows"]
    ]


def as_text(found: dict[str, tuple[Answer, tuple[Answer, ...]]]) -> str:
    """Return the file's text, with a line for each quantity, from each region's answers without skin and with each of
    SKINS."""
    head = {
        "schema": SCHEMA, "written_by": "tools/fem_table.py",
        "columns": ["name", "unit", "no skin", *(skin.name for skin in SKINS)],
        "skins": {s.name: {"thickness_m": s.thickness_m, "modulus_pa": s.modulus_pa} for s in SKINS},
        "poisson": POISSON, "friction": FRICTION, "touch_n": TOUCH_N, "matched_m": MATCHED_M,
        "sources": "skin, Poisson's ratio, friction: materials.py; grounds: cases.py; published curves: "
                   "lab/validation/rig.py",
    }  # fmt: skip
    regions = []
    for case in CASES:
        plain, skins = found[case.region]
        about = {
            "thickness_m": case.ground.thickness_m, "limb_radius_m": case.ground.limb_radius_m,
            "published": case.reference.name, "tool": case.main.name,
            "tissue_pa": [rounded(answer.modulus_pa) for answer in (plain, *skins)],
        }  # fmt: skip
        rows = [json.dumps([s.name, s.unit, s.plain, *s.skins]) for s in made(case, plain, skins)]
        lines = ",\n   ".join(rows)
        regions.append(f' "{case.region}": {{{json.dumps(about)[1:-1]},\n  "rows": [\n   {lines}]}}')
    return f'{{{json.dumps(head)[1:-1]},\n"regions": {{\n' + ",\n".join(regions) + "}}\n"


def main() -> None:
    found = {}
    for case in CASES:
        found[case.region] = judged(case)
        print(case.region, flush=True)
    FILE.write_text(as_text(found))
    print(FILE)


if __name__ == "__main__":
    main()

"""``carecontact probe``: does each score follow what it scores?"""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path

from carecontact.errors import ConfigError
from carecontact.protocols import adapted, load_protocol

SCHEMA = "carecontact-probe-1"


def probe(*, metrics: str, body: str | None, protocol: str, out: Path) -> int:
    """Exit status 1 if a score does not follow its sweep."""
    from carecontact.validation.figures import draw_figure
    from carecontact.validation.probes import PROBES, draw, run
    from carecontact.validation.subject import Subject

    names = tuple(PROBES) if metrics == "all" else tuple(part.strip() for part in metrics.split(","))
    if not set(names) <= set(PROBES) or len(set(names)) != len(names):
        raise ConfigError(
            f"--metrics {metrics!r}: expected ids parted by commas, each once; valid: {', '.join(PROBES)}"
        )
    if out.exists() and not out.is_dir():
        raise ConfigError(f"--out {out}: this is a file; name a folder")
    rules = adapted(load_protocol(protocol), body=body)
    subject = Subject(rules)
    print(f"{rules.title}, {rules.person.body}", flush=True)
    results = []
    for name in names:
        result = run(subject, PROBES[name])
        results.append(result)
        levels, scores = result.curves["scores"]
        print(f"{'pass' if result.passed else 'FAIL'}  {name}  {result.title}")
        for level, score in zip(levels, scores, strict=True):
            print(f"        {PROBES[name].level} {level:<6g} {score:.4g}", flush=True)
    passed = all(result.passed for result in results)
    out.mkdir(parents=True, exist_ok=True)
    content = {
        "schema": SCHEMA, "passed": passed, "protocol": {"id": rules.id, "sha256": rules.sha256},
        "body": rules.person.body, "probes": [result.as_json() for result in results],
    }  # fmt: skip
    (out / "probe.json").write_text(json.dumps(content, indent=2) + "\n")
    draw_figure(partial(draw, results), out / "probe.png")
    print(f"{'passed' if passed else 'FAILED'}: {out / 'probe.json'}, {out / 'probe.png'}")
    return 0 if passed else 1

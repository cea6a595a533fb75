"""``carecontact probe``: do scores follow the quantities that they measure?"""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

from carecontact.cli.groups import FLAT, RulesGroup
from carecontact.errors import ConfigError

if TYPE_CHECKING:
    from carecontact.contract.protocol import Protocol
    from carecontact.validation.result import CheckResult

SCHEMA = "carecontact-probe-1"


@dataclass(frozen=True, kw_only=True)
class Probe:
    """Check that C1, C2, C4 and C5 follow the quantities that they measure: for each score, simulate scripted
    trials in which one quantity changes step by step (a sweep, for example of the commanded depth), and plot them."""

    metrics: str = "all"
    """Ids separated by commas, such as C1,C5 (short for C1@1,C5@1), or all (C1@1, C2@1, C4@1, C5@1)."""
    rules: Annotated[RulesGroup, FLAT] = field(default_factory=RulesGroup)
    out: Path = Path("runs/probe")
    """Folder for probe.json and probe.png."""

    after_interrupt: ClassVar[str] = "; nothing was written"

    def __call__(self) -> int:
        """Return 1 if a score does not follow its sweep."""
        from carecontact.validation.probes import PROBES, run
        from carecontact.validation.subject import Subject

        short = {name.partition("@")[0].casefold(): name for name in PROBES}
        given = [part.strip() for part in self.metrics.split(",")]
        names = tuple(PROBES) if self.metrics == "all" else tuple(short.get(name.casefold(), name) for name in given)
        if not set(names) <= set(PROBES) or len(set(names)) != len(names):
            raise ConfigError(
                f"--metrics {self.metrics!r}: expected ids separated by commas, each once; valid: {', '.join(PROBES)}"
            )
        if self.out.exists() and not self.out.is_dir():
            raise ConfigError(f"--out {self.out}: this is a file; name a folder")
        rules = self.rules.load()
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
        _write(self.out, rules, results, passed=passed)
        print(f"{'passed' if passed else 'FAILED'}: {self.out / 'probe.json'}, {self.out / 'probe.png'}")
        return 0 if passed else 1


def _write(out: Path, rules: Protocol, results: list[CheckResult], *, passed: bool) -> None:
    from carecontact.validation.figures import draw_figure
    from carecontact.validation.probes import draw

    out.mkdir(parents=True, exist_ok=True)
    content = {
        "schema": SCHEMA, "passed": passed, "protocol": {"id": rules.id, "sha256": rules.sha256},
        "body": rules.person.body, "probes": [result.as_json() for result in results],
    }  # fmt: skip
    (out / "probe.json").write_text(json.dumps(content, indent=2) + "\n")
    draw_figure(partial(draw, results), out / "probe.png")

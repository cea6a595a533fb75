"""Run the checks on one person and write what they found."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from types import ModuleType

import mujoco

from carecontact.contract.protocol import Protocol
from carecontact.errors import CarecontactError, UnknownNameError
from carecontact.validation.figures import draw_figure
from carecontact.validation.result import CheckResult
from carecontact.validation.subject import MakeScene, Subject
from carecontact.world.scene import build_scene

CHECKS = {
    name: name.replace("-", "_")
    for name in (
        "force-balance", "energy", "convergence", "passive-response", "calibration-residual", "determinism",
        "sensitivity", "stability", "uniformity", "smoothness",
    )
}  # fmt: skip
"""Name -> module in this package, which has TITLE, run(subject, quick=...) and draw(result, figure). The first eight
are those of the design, in its order; the last two are acceptance measurements."""
SCHEMA = "carecontact-validation-1"


@dataclass(frozen=True, kw_only=True)
class Validation:
    body: str
    body_sha256: str
    protocol: str
    protocol_sha256: str
    tissue_set: str
    model_sha256: str
    """Of the compiled world with the forearm as target."""
    quick: bool
    results: tuple[CheckResult, ...]

    @property
    def passed(self) -> bool:
        return all(result.passed for result in self.results)

    def as_json(self) -> dict[str, object]:
        """Nothing in it depends on place, time or machine."""
        return {
            "schema": SCHEMA, "passed": self.passed, "quick": self.quick,
            "protocol": {"id": self.protocol, "sha256": self.protocol_sha256, "tissue_set": self.tissue_set},
            "body": {"name": self.body, "sha256": self.body_sha256}, "model_sha256": self.model_sha256,
            "mujoco": mujoco.__version__, "checks": [result.as_json() for result in self.results],
        }  # fmt: skip


def validate(
    protocol: Protocol,
    *,
    body: str | None = None,
    make_scene: MakeScene = build_scene,
    quick: bool = False,
    checks: Sequence[str] = tuple(CHECKS),
    on_check: Callable[[CheckResult], None] = lambda result: None,
) -> Validation:
    """Run checks one after the other; a check that cannot be finished has failed, and the others still run.

    Args:
        body: another body than the protocol's.
        make_scene: what builds the person; a test plants its defects here.
        on_check: told each result as soon as it is there.

    Raises UnknownNameError for a check that there is not, and what ``make_scene`` raises if no world can be built.
    """
    modules = [_module(name) for name in checks]
    protocol = protocol.overridden(body=body)
    subject = Subject(protocol, make_scene=make_scene)
    scene = subject.scene("forearm")
    # Before anything runs: settling writes the rest angles into a model.
    model_sha256 = scene.model_sha256
    results = []
    for name, module in zip(checks, modules, strict=True):
        results.append(_run(name, module, subject, quick=quick))
        on_check(results[-1])
    return Validation(
        body=scene.body.name, body_sha256=scene.body.sha256, protocol=protocol.id, protocol_sha256=protocol.sha256,
        tissue_set=protocol.person.tissue_set, model_sha256=model_sha256, quick=quick, results=tuple(results),
    )  # fmt: skip


def write(validation: Validation, folder: Path) -> list[Path]:
    """validation.json and one figure a check that came to its end; returns what was written."""
    folder.mkdir(parents=True, exist_ok=True)
    record = folder / "validation.json"
    record.write_text(json.dumps(validation.as_json(), indent=2) + "\n")
    written = [record]
    for result in validation.results:
        if result.error is None:
            path = folder / f"{result.check}.png"
            draw_figure(result, _module(result.check).draw, path)
            written.append(path)
    return written


def _module(name: str) -> ModuleType:
    if name not in CHECKS:
        raise UnknownNameError("check", name, CHECKS)
    return import_module(f"{__package__}.{CHECKS[name]}")


def _run(name: str, module: ModuleType, subject: Subject, *, quick: bool) -> CheckResult:
    try:
        return module.run(subject, quick=quick)
    except CarecontactError as error:
        # A person that does not settle or whose press diverges is a finding about the person.
        return CheckResult(check=name, title=module.TITLE, measures=(), error=str(error))

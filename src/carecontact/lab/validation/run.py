"""Runs the checks on one person and writes what they found."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from importlib import import_module
from pathlib import Path
from types import ModuleType

import mujoco

from carecontact.errors import CarecontactError, UnknownNameError
from carecontact.lab.validation.result import CheckResult
from carecontact.lab.validation.subject import MakeScene, Subject
from carecontact.plotting import draw_figure
from carecontact.protocol.overrides import overridden
from carecontact.protocol.protocol import Protocol
from carecontact.world.scene import build_scene

_NUMBERED = "force-balance energy convergence passive-response calibration-residual determinism sensitivity stability"
_FURTHER = "uniformity smoothness declared knocks alive"
CHECKS = {name: name.replace("-", "_") for name in f"{_NUMBERED} {_FURTHER}".split()}
"""Name -> module in this package, which has TITLE, run(subject, quick=...) and draw(result, figure). The first eight
are the numbered checks, in their order."""
SCHEMA = "carecontact-validation-1"


@dataclass(frozen=True, kw_only=True)
class Validation:
    body: str
    body_sha256: str
    protocol: Protocol
    model_sha256: str
    """sha256 of the compiled world with the forearm as target."""
    quick: bool
    asked: tuple[str, ...]
    """Names of the checks that are to run."""
    results: tuple[CheckResult, ...] = ()
    """Results of the checks that have run, in their order."""

    @property
    def finished(self) -> bool:
        return len(self.results) == len(self.asked)

    @property
    def passed(self) -> bool:
        return self.finished and all(result.passed for result in self.results)

    def as_json(self) -> dict[str, object]:
        """Return the content of validation.json. Nothing in it depends on place, time or machine."""
        rules = {
            "id": self.protocol.name,
            "sha256": self.protocol.sha256,
            "tissue_set": self.protocol.person.tissue_set,
            "dt_s": self.protocol.physics.dt_s,
        }
        return {
            "schema": SCHEMA,
            "passed": self.passed,
            "finished": self.finished,
            "quick": self.quick,
            "left_out": [name for name in CHECKS if name not in self.asked],
            "protocol": rules,
            "body": {"name": self.body, "sha256": self.body_sha256},
            "model_sha256": self.model_sha256,
            "mujoco": mujoco.__version__,
            "checks": [result.as_json() for result in self.results],
        }


def validate(
    protocol: Protocol,
    *,
    body: str | None = None,
    make_scene: MakeScene = build_scene,
    quick: bool = False,
    checks: Sequence[str] = tuple(CHECKS),
    on_check: Callable[[Validation], None] = lambda validation: None,
) -> Validation:
    """Run checks one after the other. A check that cannot be finished has failed, and the others still run.

    Args:
        body: another body than the protocol's.
        make_scene: builds the person; a test can pass a function that plants a defect.
        on_check: called after every check with everything found so far; the last result is the new one.

    Raises UnknownNameError for an unknown check, and what ``make_scene`` raises if no world can be built.
    """
    modules = [(name, _module(name)) for name in checks]
    protocol = protocol if body is None else overridden(protocol, {"person.body": body})
    subject = Subject(protocol, make_scene=make_scene)
    scene = subject.scene("forearm")
    # The hash comes before anything runs, because settling writes the rest angles into the model.
    validation = Validation(
        body=scene.body.name, body_sha256=scene.body.sha256, protocol=protocol, model_sha256=scene.model_sha256,
        quick=quick, asked=tuple(checks),
    )  # fmt: skip
    for name, module in modules:
        try:
            result = module.run(subject, quick=quick)
        except CarecontactError as error:
            # A person that does not settle or whose press diverges is a finding about the person.
            result = CheckResult(check=name, title=module.TITLE, measures=(), error=str(error))
        validation = replace(validation, results=(*validation.results, result))
        on_check(validation)
    return validation


def write(validation: Validation, folder: Path) -> list[Path]:
    """Write validation.json as far as checks have run and, if it was finished, the last check's figure."""
    folder.mkdir(parents=True, exist_ok=True)
    if len(validation.results) == 1:
        for name in CHECKS:
            # These figures are of an earlier validation, and this one may not draw all of them again.
            (folder / f"{name}.png").unlink(missing_ok=True)
    record = folder / "validation.json"
    record.write_text(json.dumps(validation.as_json(), indent=2) + "\n")
    result = validation.results[-1]
    if result.error is not None:
        return [record]
    figure = folder / f"{result.check}.png"
    draw_figure(partial(_module(result.check).draw, result), figure)
    return [record, figure]


def _module(name: str) -> ModuleType:
    if name not in CHECKS:
        raise UnknownNameError("check", name, CHECKS)
    return import_module(f"{__package__}.{CHECKS[name]}")

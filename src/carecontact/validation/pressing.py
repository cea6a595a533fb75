"""The person under test on the tissue bench, with the law of the compiled scene."""

from __future__ import annotations

from carecontact.sim.bench import Bench, Indenter
from carecontact.validation.subject import Subject


def person_bench(
    subject: Subject, region: str, indenter: Indenter, *, dt_s: float | None = None, glides: bool = False
) -> Bench:
    """Return a bench with the stiffness, damping, mass, friction and contact of the compiled person, whatever the
    protocol says.
    """
    bench = declared_bench(subject, region, indenter, dt_s=dt_s, glides=glides)
    for kind in ("law", "options"):
        bench.model.numeric(f"{region}/{kind}").data[:] = subject.scene(region).model.numeric(f"{region}/{kind}").data
    return bench


def declared_bench(
    subject: Subject, region: str, indenter: Indenter, *, dt_s: float | None = None, glides: bool = False
) -> Bench:
    """Return a bench with the law that the protocol declares, on the person's own mesh."""
    scene = subject.scene(region)
    return Bench(
        body=scene.body, region=region, tissue=subject.tissue(region), indenter=indenter,
        dt_s=dt_s or subject.protocol.physics.dt_s, shell=scene.regions[region].shell, glides=glides,
    )  # fmt: skip


def tool(subject: Subject) -> Indenter:
    """Return the tool of the protocol's robot, lying across the region."""
    return Indenter(shape="cap", tip=subject.protocol.scene.robot.tip)

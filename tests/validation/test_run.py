from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from carecontact.contract.protocol import Protocol
from carecontact.errors import SettleError, UnknownNameError
from carecontact.protocols import load_protocol
from carecontact.validation import passive_response
from carecontact.validation.result import CheckResult
from carecontact.validation.run import CHECKS, Validation, validate, write
from carecontact.validation.subject import Subject
from carecontact.world.scene import Scene, build_scene

from .defects import ActsInContactOnly, limp_wrist, unlimited


def test_unknown_checks_and_bodies_are_named() -> None:
    with pytest.raises(UnknownNameError, match="force-balance"):
        validate(load_protocol(), checks=["force-ballance"])
    with pytest.raises(UnknownNameError, match="man-adult"):
        validate(load_protocol(), body="nobody", checks=["energy"])


def test_a_person_that_does_not_settle_fails_the_check_and_the_others_go_on(monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[Validation] = []

    def never(*_: object) -> None:
        raise SettleError("person still moves at 12.0 mm/s")

    monkeypatch.setattr("carecontact.sim.simulation.Simulation.settle", never)
    validation = validate(load_protocol(), quick=True, checks=["energy", "stability"], on_check=told.append)
    assert not validation.passed
    assert [len(so_far.results) for so_far in told] == [1, 2]
    assert [so_far.finished for so_far in told] == [False, True]
    assert [so_far.results[-1].error for so_far in told] == ["person still moves at 12.0 mm/s"] * 2


def test_two_runs_write_the_same_record_without_traces_of_the_machine(tmp_path: Path) -> None:
    records = []
    for name in ("a", "b"):
        validation = validate(load_protocol(), quick=True, checks=["energy"])
        paths = write(validation, tmp_path / name)
        assert [p.name for p in paths] == ["validation.json", "energy.png"]
        assert (tmp_path / name / "energy.png").read_bytes().startswith(b"\x89PNG")
        records.append((tmp_path / name / "validation.json").read_text())
    assert records[0] == records[1]
    record = json.loads(records[0])
    assert record["body"]["name"] == load_protocol().person.body
    assert record["mujoco"]
    assert len(record["model_sha256"]) == 64
    assert str(tmp_path) not in records[0]
    assert record["passed"] is True
    (result,) = validation.results
    assert record["checks"][0]["measures"] == [measure.as_json() for measure in result.measures]
    assert sum(measure.limit is not None for measure in result.measures) >= 2


def test_missing_joint_limits_fail_the_passive_response(subject: Subject) -> None:
    missed = [m.name for m in passive_response.run(ActsInContactOnly(subject, unlimited), quick=True).missed]
    assert missed
    assert all("past its end stop" in name for name in missed)


def test_a_limp_wrist_fails_the_passive_response(subject: Subject) -> None:
    missed = [m.name for m in passive_response.run(ActsInContactOnly(subject, limp_wrist), quick=True).missed]
    assert missed == ["+10 N: wrist bends"]


def test_the_factory_builds_every_world() -> None:
    """Variants too: a defect must not get lost where a check changes the time step or the tissue."""
    built: list[float] = []

    def watched(protocol: Protocol, *, target: str | None, skin: bool) -> Scene:
        built.append(protocol.physics.dt_s)
        return build_scene(protocol, target=target, skin=skin)

    watching = Subject(load_protocol(), make_scene=watched)
    watching.with_dt(0.001).scene("forearm")
    region = watching.tissue("forearm").model_copy(update={"friction": 0.123})
    scene = watching.with_tissue("forearm", region).scene("forearm")
    # The body's own row of tissue is read off a world, too.
    assert built[0] == 0.001
    assert set(built[1:]) == {0.002}
    friction = [name for name in scene.regions if 0.123 in scene.model.numeric(f"{name}/law").data]
    assert friction == ["forearm"]


def test_every_check_has_a_title_of_its_own() -> None:
    from importlib import import_module

    titles = [import_module(f"carecontact.validation.{module}").TITLE for module in CHECKS.values()]
    assert len(set(titles)) == len(CHECKS)


@pytest.mark.parametrize("check", CHECKS)
def test_the_protocols_person_misses_nothing_in_the_short_form(
    check: str, short_form: Callable[[str], CheckResult]
) -> None:
    result = short_form(check)
    assert result.check == check
    assert result.error is None
    assert [f"{m.name} {m.value:.3g}" for m in result.missed] == []
    assert any(m.limit is not None for m in result.measures)

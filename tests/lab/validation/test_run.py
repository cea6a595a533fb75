from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import griddata

from carecontact.errors import SettleError, UnknownNameError
from carecontact.interface.robot import PANDA_MITT
from carecontact.lab.validation import passive_response
from carecontact.lab.validation.calibration_residual import held_out_m
from carecontact.lab.validation.result import CheckResult, Measure
from carecontact.lab.validation.rig import (
    ABDOMEN,
    CAP,
    FITTED,
    FOREARM,
    FOREARM_POSTERIOR,
    REFERENCES,
    UPPER_ARM_ANTERIOR,
    UPPER_ARM_POSTERIOR,
    Rig,
    person_bench,
    robot_tool,
    tool,
)
from carecontact.lab.validation.run import CHECKS, Validation, validate, write
from carecontact.lab.validation.subject import Subject, skin_points, surface_point
from carecontact.protocol.load import load_protocol
from carecontact.protocol.overrides import overridden, shipped_tissue_sets
from carecontact.protocol.protocol import Protocol
from carecontact.tissue.plugin import ENTRY_M, LAYER_M, LOCK
from carecontact.world.scene import Scene, build_scene
from tests.lab.validation.defects import ActsInContactOnly, limp_wrist, unlimited


def test_unknown_checks_and_bodies_are_named() -> None:
    with pytest.raises(UnknownNameError, match="force-balance"):
        validate(load_protocol("bathing-v3"), checks=["force-ballance"])
    with pytest.raises(UnknownNameError, match="man-adult"):
        validate(load_protocol("bathing-v3"), body="no-body", checks=["energy"])


def test_a_person_that_does_not_settle_fails_the_check_and_the_others_go_on(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[Validation] = []

    def never(*_: object) -> None:
        raise SettleError("person still moves at 12.0 mm/s")

    monkeypatch.setattr("carecontact.sim.simulation.Simulation.settle", never)
    validation = validate(load_protocol("bathing-v3"), quick=True, checks=["energy", "stability"], on_check=seen.append)
    assert not validation.passed
    assert [len(so_far.results) for so_far in seen] == [1, 2]
    assert [so_far.finished for so_far in seen] == [False, True]
    assert [so_far.results[-1].error for so_far in seen] == ["person still moves at 12.0 mm/s"] * 2


def test_two_runs_write_the_same_record_without_traces_of_the_machine(tmp_path: Path) -> None:
    records = []
    for name in ("a", "b"):
        validation = validate(load_protocol("bathing-v3"), quick=True, checks=["energy"])
        paths = write(validation, tmp_path / name)
        assert [p.name for p in paths] == ["validation.json", "energy.png"]
        assert (tmp_path / name / "energy.png").read_bytes().startswith(b"\x89PNG")
        records.append((tmp_path / name / "validation.json").read_text())
    assert records[0] == records[1]
    record = json.loads(records[0])
    assert record["body"]["name"] == load_protocol("bathing-v3").person.body
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

    watching = Subject(load_protocol("bathing-v3"), make_scene=watched)
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

    titles = [import_module(f"carecontact.lab.validation.{module}").TITLE for module in CHECKS.values()]
    assert len(set(titles)) == len(CHECKS)


SLOW = {"determinism": pytest.mark.slow}
"""Two trials in fresh processes; the tests of ``running`` compare the hashes of the same trial as well."""


@pytest.mark.parametrize("check", [pytest.param(check, marks=SLOW.get(check, ())) for check in CHECKS])
def test_the_protocols_person_misses_nothing_in_the_short_form(
    check: str, short_form: Callable[[str], CheckResult]
) -> None:
    result = short_form(check)
    assert result.check == check
    assert result.error is None
    assert [f"{m.name} {m.value:.3g}" for m in result.missed] == []
    assert any(m.limit is not None for m in result.measures)


@pytest.mark.slow
def test_trials_with_undefined_readings_are_deterministic() -> None:
    """A policy of the exam that asks for no second look is sent no second camera pose, which a recording has as NaN."""
    from carecontact.lab.validation import determinism

    assert determinism.run(Subject(load_protocol("bathing-wide-v2", level="L2")), quick=True).missed == []


def result(*measures: Measure, error: str | None = None) -> CheckResult:
    return CheckResult(check="c", title="C", measures=measures, error=error)


@pytest.mark.parametrize(
    ("value", "side", "met"),
    [(1.0, "at most", True), (1.1, "at most", False), (1.0, "at least", True), (0.9, "at least", False),
     (1.0, "below", False), (0.9, "below", True), (float("nan"), "at most", False), (float("-inf"), "at most", False),
     (float("inf"), "at least", False)],
)  # fmt: skip
def test_a_line_is_met_on_its_own_side(value: float, side, met: bool) -> None:
    assert Measure(name="m", value=value, limit=1.0, side=side).met is met


def test_without_a_limit_nothing_is_met_or_missed() -> None:
    assert Measure(name="m", value=float("nan")).met is None


def test_only_deciding_lines_decide() -> None:
    good, bad = Measure(name="a", value=0.0, limit=1.0), Measure(name="b", value=2.0, limit=1.0)
    shown = Measure(name="b", value=2.0, limit=1.0, decides=False)
    assert result(good, shown).passed
    assert result(good, shown).missed == []
    assert not result(good, bad).passed
    assert result(good, bad).missed == [bad]


def test_a_check_that_decides_nothing_has_not_passed() -> None:
    assert not result().passed
    assert not result(Measure(name="a", value=0.0)).passed
    assert not result(Measure(name="a", value=0.0, limit=1.0), error="it did not settle").passed


def test_value_names_what_there_is() -> None:
    assert result(Measure(name="a", value=3.0)).value("a") == 3.0
    with pytest.raises(KeyError, match="there are: a"):
        result(Measure(name="a", value=3.0)).value("b")


@given(st.floats(allow_nan=True, allow_infinity=True), st.floats(allow_nan=False, allow_infinity=False))
def test_json_is_strict_and_close(value: float, limit: float) -> None:
    got = json.loads(json.dumps(Measure(name="m", value=value, limit=limit).as_json(), allow_nan=False))
    if got["value"] is None:
        assert value != value or abs(value) == float("inf")
    else:
        assert got["value"] == pytest.approx(value, rel=1e-5)


# Where scripted contacts aim.


@pytest.mark.parametrize("offset", [0.0, 0.03])
def test_surface_point_lies_on_the_skin_under_it(subject: Subject, offset: float) -> None:
    """Not on the highest vertex near it, which on a sloping arm is another on every mesh."""
    simulation = subject.at_rest("forearm")
    point = surface_point(simulation, "forearm", (offset, 0.0))
    skin = skin_points(simulation, "forearm")
    near = skin[(np.linalg.norm(skin[:, :2] - point[:2], axis=1) < 0.02) & (skin[:, 2] > point[2] - 0.03)]
    height = float(griddata(near[:, :2], near[:, 2], point[:2])[0])
    assert point[2] == pytest.approx(height, abs=3e-4)
    assert point[2] < near[np.linalg.norm(near[:, :2] - point[:2], axis=1) < 0.015][:, 2].max() - 3e-4


# Checks press and drag with the tool of the protocol's robot.


@pytest.fixture(scope="module")
def with_mitt() -> Subject:
    return Subject(overridden(load_protocol("bathing-v3"), {"scene.tool": "mitt"}))


def test_the_bench_presses_with_the_mitt_and_its_pile(subject: Subject, with_mitt: Subject) -> None:
    """A larger tool needs more force at a depth, and less than a rigid one of its size."""
    force = {
        name: person_bench(of, "forearm", indenter).response(np.array([0.004]))[0]
        for name, of, indenter in (
            ("cap", subject, tool(subject)),
            ("mitt", with_mitt, tool(with_mitt)),
            ("rigid", with_mitt, replace(tool(with_mitt), tip=replace(PANDA_MITT.tip, give_m3_n=0.0))),
        )
    }
    assert max(force["cap"], force["mitt"]) < force["rigid"]


def test_the_rig_s_tool_is_the_mitt(subject: Subject, with_mitt: Subject) -> None:
    assert robot_tool(subject) is CAP
    made = robot_tool(with_mitt)
    assert (made.name, made.size_m, made.height_m) == ("mitt", PANDA_MITT.tip.half_m, PANDA_MITT.tip.half_m[2])
    rig = Rig(with_mitt, "forearm", made, joints="slides")
    assert rig.model.geom_user[rig.model.body("tool").geomadr[0], 0] == PANDA_MITT.tip.give_m3_n


def test_bench_and_rig_touch_as_the_person_is_touched(subject: Subject) -> None:
    for model in (
        subject.scene("forearm").model, person_bench(subject, "forearm", tool(subject)).model,
        Rig(subject, "forearm", CAP, joints="slides").model,
    ):  # fmt: skip
        assert model.numeric("forearm/contact").data.tolist() == [LAYER_M, ENTRY_M, LOCK]


# The table against the published secants that it was entered from.


@pytest.mark.parametrize(
    ("reference", "depth_mm", "secant", "band"),
    [(FOREARM, 4.487, 1.190, (0.7445, 2.1519)), (FOREARM_POSTERIOR, 4.207, 1.469, (0.8053, 2.7353)),
     (UPPER_ARM_ANTERIOR, 8.163, 0.6445, (0.4341, 1.4601)),
     (UPPER_ARM_POSTERIOR, 7.951, 0.797, (0.3890, 1.3969))],
)  # fmt: skip
def test_limb_curves_end_at_the_measured_secants(reference, depth_mm: float, secant: float, band) -> None:
    depth = 1000 * reference.depth_m[-1]
    assert depth == pytest.approx(depth_mm, rel=1e-6)
    assert reference.force_n[-1] / depth == pytest.approx(secant, rel=0.002)
    assert [reference.low_n[-1] / depth, reference.high_n[-1] / depth] == pytest.approx(list(band), rel=0.002)


def test_abdomen_is_the_published_polynomial() -> None:
    depth = 1000 * ABDOMEN.depth_m
    np.testing.assert_allclose(ABDOMEN.force_n, 0.1665 * depth + 0.00873 * depth**2, atol=0.12)


@pytest.mark.parametrize("reference", REFERENCES, ids=lambda r: r.name)
def test_curves_rise_inside_their_band(reference) -> None:
    assert (np.diff(reference.depth_m) > 0).all()
    assert (np.diff(reference.force_n) > 0).all()
    assert (reference.low_n <= reference.force_n).all()
    assert (reference.force_n <= reference.high_n).all()
    assert len(held_out_m(reference.region)) >= 3


def test_what_a_set_was_fitted_to_is_known_and_the_set_shipped() -> None:
    assert set(FITTED) < set(shipped_tissue_sets())
    names = {reference.name for reference in REFERENCES}
    assert len(names) == len(REFERENCES)
    for fitted in FITTED.values():
        assert {reference.name for reference in fitted} < names

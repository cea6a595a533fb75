"""The validation passes on the shipped persons and fails, by the right check, on persons with a planted defect."""

from __future__ import annotations

import pytest

from carecontact.protocols import load_protocol
from carecontact.validation.run import CHECKS, Validation, validate
from carecontact.world.human.library import body_names
from tests.validation.defects import (
    half_stiff,
    old_bone,
    overdamped,
    soft_contact,
    soft_upper_arm,
    uncoupled,
    undamped,
)

pytestmark = pytest.mark.slow


def missed(validation: Validation) -> dict[str, str | list[str]]:
    return {r.check: r.error or [f"{m.name} {m.value:.3g}" for m in r.missed] for r in validation.results}


@pytest.mark.parametrize("body", [name for name in body_names() if name != load_protocol().person.body])
def test_a_shipped_body_misses_nothing_in_the_short_form(body: str) -> None:
    validation = validate(load_protocol(), body=body, quick=True)
    assert len(validation.results) == len(CHECKS)
    assert missed(validation) == {name: [] for name in CHECKS}


@pytest.mark.parametrize("body", ["man-adult", "man-adult-heavy", "man-old-heavy", "woman-adult-heavy"])
def test_a_body_misses_nothing_in_the_full_form(body: str) -> None:
    """Minutes each."""
    assert missed(validate(load_protocol(), body=body)) == {name: [] for name in CHECKS}


def test_zeroed_damping_fails_the_energy_check() -> None:
    result = validate(load_protocol(), make_scene=undamped, quick=True, checks=["energy"]).results[0]
    assert not result.passed
    assert result.error or any("work of the declared law" in m.name for m in result.missed)


def test_threefold_tissue_damping_fails_the_energy_check() -> None:
    result = validate(load_protocol(), make_scene=overdamped, quick=True, checks=["energy"]).results[0]
    assert any("work against that of the declared law" in m.name for m in result.missed)


def test_one_region_softer_than_declared_fails_the_energy_check() -> None:
    """The upper arm has no reference of its own in `paper-mapping`."""
    result = validate(load_protocol(), make_scene=soft_upper_arm, checks=["energy"]).results[0]
    assert {m.name for m in result.missed} == {
        f"upper_arm loop at {speed} mm/s: deviation of the peak force from the declared law" for speed in (5, 20)
    }


def test_a_softer_contact_fails_the_calibration_residual() -> None:
    result = validate(load_protocol(), make_scene=soft_contact, quick=True, checks=["calibration-residual"]).results[0]
    assert {m.name.partition(",")[0] for m in result.missed if "NRMSE" in m.name} >= {"forearm"}


def test_half_stiffness_fails_the_calibration_residual() -> None:
    result = validate(load_protocol(), make_scene=half_stiff, quick=True, checks=["calibration-residual"]).results[0]
    missed = [m for m in result.missed if "NRMSE" in m.name]
    assert {m.name.partition(",")[0] for m in missed} == {"forearm", "abdomen"}
    assert min(m.value for m in missed) > 20.0


def test_bone_of_the_arm_that_does_not_give_fails_the_knocks() -> None:
    """Elsewhere, the person is sound."""
    result = validate(load_protocol(), make_scene=old_bone, quick=True, checks=["knocks"]).results[0]
    missed = {m.name.partition(":")[0] for m in result.missed}
    assert missed == {f"{site}, 10 kg at 0.2 m/s" for site in ("shoulder cap", "elbow", "forearm")}


def test_missing_coupling_fails_the_calibration_residual() -> None:
    result = validate(load_protocol(), make_scene=uncoupled, quick=True, checks=["calibration-residual"]).results[0]
    assert {m.name.partition(",")[0] for m in result.missed if "NRMSE" in m.name} == {"forearm", "abdomen"}

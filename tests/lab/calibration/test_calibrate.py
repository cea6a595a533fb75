"""The command on small data: what it writes, prints and verifies."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from carecontact.api.evaluate import evaluate
from carecontact.cli import main
from carecontact.cli.groups import RulesGroup
from carecontact.errors import ConfigError
from carecontact.lab.calibration.calibrate import hardly_identified
from carecontact.lab.calibration.certificate import Value, content_sha256, read_certificate, reasons
from carecontact.lab.calibration.trial import template
from carecontact.protocol.load import load_protocol
from carecontact.protocol.overrides import load_tissue_set
from carecontact.tissue import binary_lookup
from tests.lab.calibration.conftest import HEADER, save

Change = Callable[[Any], dict[str, object]]


def presses(count: int, *, cell_n: float = np.inf, factor: float = 1.0) -> list[str]:
    """Loading only, F = 0.25 d + 0.05 d^2 [N, mm] to 3 mm at 20 mm/s with a ball, a few percent apart.

    ``cell_n``: where the load cell saturates; ``factor``: of another unit of force.
    """
    out = []
    for number in range(count):
        travel = np.linspace(-1.0, 3.0, 80)
        d = np.maximum(travel, 0.0)
        force = factor * np.minimum((0.25 * d + 0.05 * d**2) * (1 + 0.03 * (number - 1)), cell_n)
        out += [
            f"t{number},forearm synthetic,p{number},{(s + 1) / 20:.5f},{s:.5f},{f:.5f},load,20,hemisphere,10,0,none"
            for s, f in zip(travel, force, strict=True)
        ]
    return out


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("calibration")
    trials = save(folder / "trials.csv", presses(3))
    assert main(["calibrate", str(trials), "--region", "forearm", "--out", str(folder / "out")]) == 0
    return folder


def test_certificate_says_what_was_found(made: Path) -> None:
    content = read_certificate(made / "out" / "certificate.json").content
    assert content.trials == content.subjects == 3
    assert content.synthetic
    nrmse = content.agreement["nrmse"].value
    assert nrmse is not None
    assert nrmse < 0.08
    low, high = content.law["a_n_m3"].ci95 or (0.0, 0.0)
    assert 0 < low <= high
    # Trials that do not unload say nothing of damping.
    assert content.law["damping_ns_m3"].value is None
    assert content.agreement["work_error"].value is None
    assert any("no trial unloads" in note for note in content.notes)
    assert any("held-out NRMSE" in line for line in content.terms)
    assert content.versions["kernel"] == binary_lookup.binary_sha256()
    assert content.gate_is_extrapolated
    assert content.measured_depth_mm == pytest.approx(2.95, abs=0.15)
    # The row counts how deep the anchors went: where a triangle's corners lie on a ball of 10 mm, its middle stands off
    # by up to 0.45 mm.
    assert 0.8 < 1000 * content.tissue.measured_depth_m / content.measured_depth_mm < 1.1


def test_parameters_that_the_data_do_not_pin_down_are_named() -> None:
    law = {
        "a_n_m3": Value(value=2e6, ci95=(1.9e6, 2.1e6)),
        "b_n_m4": Value(value=-3e8, ci95=(-6e8, 1e8)),
        "c_n_m5": Value(value=4.9e8, ci95=(2.2e8, 1.2e10)),
        "damping_ns_m3": Value(value=None, ci95=None),
        "damping_growth_ns_m4": Value(value=0.0, ci95=None),
    }
    notes = hardly_identified(law)
    assert [note.partition(" ")[0] for note in notes] == ["b_n_m4", "c_n_m5"]
    assert "-6e+08 to 1e+08" in notes[0]
    assert "2.2e+08 to 1.2e+10" in notes[1]
    assert hardly_identified({"b_n_m4": Value(value=-3e8, ci95=(-4e8, -2e8))}) == []
    assert "b_n_m4 is 0" in hardly_identified({"b_n_m4": Value(value=0.0, ci95=None)})[0]


def test_row_is_a_tissue_set(made: Path) -> None:
    chosen = load_tissue_set(str(made / "out" / "tissue.toml"))
    content = read_certificate(made / "out" / "certificate.json").content
    assert chosen.tissue["forearm"] == content.tissue
    assert chosen.tissue["abdomen"] == load_protocol("bathing-v3").person.tissue["abdomen"]
    assert "synthetic" in chosen.tissue["forearm"].source
    assert "on the kernel" in chosen.tissue["forearm"].source


def test_figure_is_written(made: Path) -> None:
    assert (made / "out" / "calibration.png").read_bytes().startswith(b"\x89PNG")


def test_same_data_same_content_and_every_evaluation_is_shown(made: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Nothing in it depends on when or where it was made."""
    again = made / "again"
    assert main(["calibrate", str(made / "trials.csv"), "--region", "forearm", "--out", str(again)]) == 0
    first, second = (read_certificate(folder / "certificate.json") for folder in (made / "out", again))
    assert first.sha256 == second.sha256
    # A fit takes minutes: each evaluation says how far it is.
    assert "evaluation 3: NRMSE" in capsys.readouterr().out


def test_verify_passes_here(made: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["calibrate", str(made / "trials.csv"), "--verify", str(made / "out" / "certificate.json")]
    assert main(arguments) == 0
    out = capsys.readouterr().out
    assert "certificate was reproduced" in out
    # On the same machine to the last digit that is written.
    assert "0.000%" in out


def forged(made: Path, **change: object) -> Path:
    """A certificate of other content whose hash is right."""
    old = read_certificate(made / "out" / "certificate.json")
    content = old.content.model_copy(update=change)
    path = made / "forged.json"
    text = old.model_copy(update={"content": content, "sha256": content_sha256(content)}).model_dump(mode="json")
    path.write_text(json.dumps(text))
    return path


def test_verify_fails_where_forces_are_others(made: Path, capsys: pytest.CaptureFixture[str]) -> None:
    content = read_certificate(made / "out" / "certificate.json").content
    a = 1.2 * content.tissue.a_n_m3
    path = forged(
        made, tissue=content.tissue.model_copy(update={"a_n_m3": a}),
        law={**content.law, "a_n_m3": Value(value=a, ci95=None)},
    )  # fmt: skip
    assert main(["calibrate", str(made / "trials.csv"), "--verify", str(path)]) == 1
    out = capsys.readouterr().out
    assert "FAIL" in out
    assert "certificate was not reproduced" in out


CONTRADICTIONS: dict[str, tuple[Change, str]] = {
    "law": (lambda c: {"tissue": c.tissue.model_copy(update={"a_n_m3": 2 * c.tissue.a_n_m3})}, "states a_n_m3"),
    "band": (lambda c: {"band": {**c.band, "error_change": 1.0}}, "the certificate allows"),
    "responses": (lambda c: {"responses": []}, "0 of other trials"),
    "depths": (
        lambda c: {"responses": [r.model_copy(update={"loading_n": [1.0]}) for r in c.responses]},
        "depths expected",
    ),
    "agreement": (lambda c: {"agreement": {}}, "agreement has []"),
    "stiffness": (lambda c: {"stiffness": {}}, "stiffness has []"),
    "trials": (lambda c: {"trials": 400}, "states trials 400, its data give 3"),
    "subjects": (lambda c: {"subjects": 40}, "states subjects 40"),
    "synthetic": (lambda c: {"synthetic": False}, "states synthetic False"),
    "depth": (lambda c: {"measured_depth_mm": 50.0}, "states measured_depth_mm 50"),
    "measured": (
        lambda c: {"measured_stiffness": {**c.measured_stiffness, "secant_n_mm": 9.0}},
        "states measured_stiffness",
    ),
    "gate": (lambda c: {"gate_is_extrapolated": False}, "not extrapolated"),
    "row's depth": (
        lambda c: {"tissue": c.tissue.model_copy(update={"measured_depth_m": 0.015})},
        "no anchor went deeper",
    ),
    "body": (lambda c: {"hashes": {**c.hashes, "body": "0" * 64}}, "another man-adult: sha256 000000000000"),
    "hashes": (lambda c: {"hashes": {"data": c.hashes["data"]}}, "no hash of: body, mesh, model"),
    "versions": (lambda c: {"versions": {}}, "mujoco"),
    "limits": (lambda c: {"limits": {**c.limits, "nrmse": 0.5}}, "accepts errors up to"),
    "verdict": (lambda c: {"held_out": {**c.held_out, "nrmse": Value(value=0.2, ci95=None)}}, "held-out NRMSE 20.0%"),
    "rejected": (lambda c: {"verdict": "rejected"}, "says rejected, its own figures: accepted"),
    "row's verdict": (
        lambda c: {"tissue": c.tissue.model_copy(update={"calibration": None})},
        "its tissue row nothing",
    ),
    "plateaus": (lambda c: {"plateaus": {"t0": 1.0}}, "its own figures: the force stays the same"),
    "kernel": (lambda c: {"versions": {"mujoco": c.versions["mujoco"]}}, "the kernel that made it"),
}


@pytest.mark.parametrize(("change", "message"), CONTRADICTIONS.values(), ids=CONTRADICTIONS)
def test_a_certificate_that_contradicts_itself_is_refused(
    change: Change, message: str, made: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = forged(made, **change(read_certificate(made / "out" / "certificate.json").content))
    assert main(["calibrate", str(made / "trials.csv"), "--verify", str(path)]) == 2
    assert message in capsys.readouterr().err


@pytest.mark.parametrize(
    ("change", "row"),
    [
        (lambda c: {"agreement": {**c.agreement, "nrmse": Value(value=0.9, ci95=None)}}, "nrmse"),
        (lambda c: {"agreement": {**c.agreement, "nrmse": Value(value=0.0001, ci95=None)}}, "nrmse"),
        (lambda c: {"stiffness": {**c.stiffness, "secant_n_mm": Value(value=9.0, ci95=None)}}, "secant_n_mm"),
        (
            lambda c: {
                "responses": [
                    r.model_copy(update={"loading_n": [*r.loading_n[:-2], np.nan, r.loading_n[-1]]})
                    for r in c.responses
                ]
            },
            "response",
        ),
    ],
    ids=["worse", "better", "stiffer", "nan"],
)
def test_what_is_computed_again_must_be_what_is_stated(
    change: Change, row: str, made: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = forged(made, **change(read_certificate(made / "out" / "certificate.json").content))
    assert main(["calibrate", str(made / "trials.csv"), "--verify", str(path)]) == 1
    out = capsys.readouterr().out
    assert any(row in line and "FAIL" in line for line in out.splitlines())


def test_a_press_deeper_than_the_tissue_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    travel = np.linspace(-1.0, 30.0, 80)
    rows = [f"t0,forearm,p0,{(s + 1) / 20:.5f},{s:.5f},{max(s, 0.0):.5f},load,20,hemisphere,10,0,none" for s in travel]
    trials = save(tmp_path / "deep.csv", rows)
    assert main(["calibrate", str(trials), "--region", "forearm", "--out", str(tmp_path / "out")]) == 2
    assert "the tissue over the forearm's bone is only 18 mm thick" in capsys.readouterr().err


def test_verify_wants_the_same_data(made: Path, capsys: pytest.CaptureFixture[str]) -> None:
    other = save(made / "other.csv", presses(2))
    assert main(["calibrate", str(other), "--verify", str(made / "out" / "certificate.json")]) == 2
    assert "verify with the same file" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("text", "message"),
    [("{}", "not a calibration certificate"), ("", "not a calibration certificate"), (None, "no such file")],
)
def test_bad_certificates(text: str | None, message: str, made: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = made / "bad.json"
    path.unlink(missing_ok=True)
    if text is not None:
        path.write_text(text)
    assert main(["calibrate", str(made / "trials.csv"), "--verify", str(path)]) == 2
    assert message in capsys.readouterr().err


def test_changed_certificate_is_refused(made: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = (made / "out" / "certificate.json").read_text().replace('"trials": 3', '"trials": 30')
    (made / "changed.json").write_text(text)
    assert main(["calibrate", str(made / "trials.csv"), "--verify", str(made / "changed.json")]) == 2
    assert "was changed after it was written" in capsys.readouterr().err


def test_a_single_trial_is_rejected(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    trials = save(tmp_path / "t.csv", presses(1))
    assert main(["calibrate", str(trials), "--region", "forearm", "--out", str(tmp_path / "out")]) == 1
    content = read_certificate(tmp_path / "out" / "certificate.json").content
    assert content.held_out is None
    assert content.law["a_n_m3"].ci95 is None
    assert content.tissue.calibration is not None
    assert content.tissue.calibration.nrmse is None
    assert load_tissue_set(str(tmp_path / "out" / "tissue.toml")).tissue["forearm"] == content.tissue
    assert "a single trial leaves nothing to hold out" in capsys.readouterr().out


def test_damping_of_a_single_trial_has_no_interval_and_says_so(tmp_path: Path) -> None:
    there = np.linspace(-1.0, 3.0, 80)
    rows = []
    for phase, travel, share in (("load", there, 1.1), ("unload", there[-2::-1], 0.9)):
        for s in travel:
            d, t = max(s, 0.0), len(rows) * (there[1] - there[0]) / 20
            force = share * (0.25 * d + 0.05 * d**2)
            rows.append(f"t0,forearm synthetic,p0,{t:.5f},{s:.5f},{force:.5f},{phase},20,hemisphere,10,0,none")
    trials = save(tmp_path / "t.csv", rows)
    assert main(["calibrate", str(trials), "--region", "forearm", "--out", str(tmp_path / "out")]) == 1
    content = read_certificate(tmp_path / "out" / "certificate.json").content
    assert content.law["damping_ns_m3"].ci95 is None
    assert "single trial" in content.damping


def test_user_errors_are_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    trials = save(tmp_path / "t.csv", presses(1), header=HEADER.replace("force_N", "forse_N"))
    for arguments, message in (
        ([str(trials), "--region", "forearm"], "no column force_N (is it 'forse_N'?)"),
        ([], "TRIALS.csv is missing"),
        ([str(trials), "--region", "knee"], "--region 'knee' is not a soft region of bathing-wide-v2; valid: forearm"),
        ([str(trials), "--indenter", "cone:5"], "indenter_shape"),
        ([str(trials), "--indenter", "flat"], "--indenter 'flat': '' is not a number"),
        ([str(trials), "--at", "5"], "--at '5': expected ALONG,ACROSS"),
        ([str(trials), "--setup", str(tmp_path / "none.toml")], "No such file"),
    ):
        assert main(["calibrate", *arguments]) == 2
        error = capsys.readouterr().err
        assert message in error
        assert len(error.strip().splitlines()) == 1


def test_the_template_is_printed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["calibrate", "--template"]) == 0
    assert capsys.readouterr().out == template()


@pytest.mark.parametrize(("factor", "times"), [(1000 / 9.80665, "120 times"), (0.05, "0.05")])
def test_force_in_another_unit_is_named_before_the_fit(
    factor: float, times: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Grams, and volts of 20 N each. Millinewtons are refused even before a simulation."""
    trials = save(tmp_path / "t.csv", presses(3, factor=factor))
    assert main(["calibrate", str(trials), "--region", "forearm", "--out", str(tmp_path / "out")]) == 2
    found = capsys.readouterr()
    assert f"column force_N: the measured forces are {times}" in found.err
    assert "times those of a published forearm under the same presses" in found.err
    assert "grams, volts or millinewtons" in found.err
    assert "evaluation" not in found.out
    assert not (tmp_path / "out").exists()


@pytest.fixture(scope="module")
def saturated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the trials of a load cell that saturates, and with what was made of them."""
    folder = tmp_path_factory.mktemp("saturated")
    trials = save(folder / "trials.csv", presses(3, cell_n=0.6))
    assert main(["calibrate", str(trials), "--region", "forearm", "--out", str(folder / "out")]) == 1
    return folder


def test_a_saturated_cell_is_rejected_by_name(saturated: Path, capsys: pytest.CaptureFixture[str]) -> None:
    content = read_certificate(saturated / "out" / "certificate.json").content
    assert content.verdict == "rejected"
    assert set(content.plateaus) == {"t0", "t1", "t2"}
    assert any("a saturated load cell does that" in reason for reason in content.reasons)
    row = load_tissue_set(str(saturated / "out" / "tissue.toml")).tissue["forearm"].calibration
    assert row is not None
    assert row.verdict == "rejected"
    assert row.reasons == tuple(content.reasons)
    assert main(["calibrate", str(saturated / "trials.csv"), "--verify", str(saturated / "out/certificate.json")]) == 1
    out = capsys.readouterr().out
    assert "the certificate was reproduced on this machine" in out
    assert "the calibration of the forearm was rejected" in out


def test_a_rejected_row_runs_only_where_it_is_allowed(saturated: Path, made: Path, tmp_path: Path) -> None:
    rejected, accepted = (
        {"tissue": {"person.tissue_set": (str(f / "out" / "tissue.toml"),)}} for f in (saturated, made)
    )
    loaded = load_protocol("bathing-v3")
    with pytest.raises(ConfigError, match=r"rejected-forearm-.*forearm \(the force stays|.*--allow-rejected uses it"):
        RulesGroup().changed(loaded, **rejected)
    assert "rejected-forearm" in RulesGroup(allow_rejected=True).changed(loaded, **rejected).title
    assert "calibrated-forearm" in RulesGroup().changed(loaded, **accepted).title
    with pytest.raises(ConfigError, match="allow-rejected"):
        evaluate("zero-action", out=tmp_path / "run", overrides=dict(rejected["tissue"]))


def test_a_hertz_like_abdomen_without_losses_is_rejected(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Friction between indenter and skin loses work that these trials do not lose."""
    there = np.linspace(-1.0, 15.0, 60)
    lines = []
    for number in range(2):
        travel = np.r_[there, there[-2::-1]]
        lines += [
            f"t{number},abdomen,p,{k * 16 / 59 / 50:.5f},{s:.5f},{(6 + number / 10) * (max(s, 0) / 15) ** 1.5:.5f},"
            f"{'load' if k < 60 else 'unload'},50,hemisphere,10,0,none"
            for k, s in enumerate(travel)
        ]
    trials = save(tmp_path / "t.csv", lines)
    assert main(["calibrate", str(trials), "--region", "abdomen", "--out", str(tmp_path / "out")]) == 1
    content = read_certificate(tmp_path / "out" / "certificate.json").content
    assert any(reason.startswith("held-out total work lost +") for reason in content.reasons)
    assert "FAIL" in capsys.readouterr().out


def test_every_limit_and_every_doubt_has_its_reason(made: Path) -> None:
    content = read_certificate(made / "out" / "certificate.json").content
    assert content.verdict == "accepted"
    assert reasons(content) == []
    held = content.held_out
    assert held is not None
    for name, value, message in (
        ("nrmse", 0.051, "held-out NRMSE 5.1%, limit 5%"),
        ("tangent_error", -0.185, "held-out tangent stiffness -18.5%, limit 5%"),
        ("tangent_error", float("nan"), "held-out tangent stiffness +nan%, limit 5%"),
        ("work_error", 1.67, "held-out total work lost +167.0%, limit 10%"),
    ):
        changed = {**held, name: Value(value=value, ci95=None)}
        assert reasons(content.model_copy(update={"held_out": changed})) == [message]
    assert "far from published tissue" in reasons(content.model_copy(update={"published_ratio": 0.1}))[0]
    outside = {**content.law, "a_n_m3": Value(value=2e6, ci95=(3e6, 4e6))}
    assert "estimate of a_n_m3 is 2e+06 and lies outside" in reasons(content.model_copy(update={"law": outside}))[0]


@pytest.mark.parametrize("region", ["forearm", "abdomen"])
def test_shipped_examples_are_small_and_labelled(region: str) -> None:
    path = Path(__file__).parents[3] / "examples" / "calibration" / f"{region}_synthetic.csv"
    text = path.read_text()
    assert path.stat().st_size < 300_000
    assert text.startswith("# SYNTHETIC")
    assert all("synthetic" in line for line in text.splitlines()[2:])

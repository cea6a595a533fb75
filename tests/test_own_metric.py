"""A stranger's metric, in one file of another package, stands wherever the built-in ones stand."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

import carecontact
from carecontact.recording import read_recording, write_recording
from tests.scoring.synthetic import make_recording, touch

OWN_METRIC_FILE = """
from carecontact.scoring import metric
from carecontact.scoring.contact import Contact

@metric("mean_force@1", title="Mean force of the touch", unit="N", better="lower", digits=3, matters=0.5)
def mean_force(contact: Contact) -> float | None:
    return float(contact.force_in_window.mean()) if contact.valid else None
"""
COMMANDS = """
from carecontact.cli import main
for command in (["report", "--rescore", "-v", "a"], ["report", "--rescore", "b", "--jobs", "2"], ["report", "a"],
                ["compare", "a", "b", "--out", "both"], ["list", "metrics"]):
    print("#", *command)
    assert main(command) == 0
"""


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, str]]:
    """Folder of two runs, and what each command printed, with the metric's package installed."""
    folder = tmp_path_factory.mktemp("own")
    for name, force in (("a", 5.0), ("b", 8.0)):
        (folder / name).mkdir()
        for seed in range(3):
            write_recording(touch(seed=seed, force=force, policy=name), folder / name / f"T1-s{seed:03d}.h5")
        write_recording(make_recording("T1", seed=3, policy=name), folder / name / "T1-s003.h5")
    site = folder / "site"
    (site / "touch_metrics-1.0.dist-info").mkdir(parents=True)
    (site / "touch_metrics.py").write_text(OWN_METRIC_FILE)
    (site / "touch_metrics-1.0.dist-info" / "METADATA").write_text(
        "Metadata-Version: 2.1\nName: touch-metrics\nVersion: 1.0\n"
    )
    entry = "[carecontact.metrics]\nmean_force@1 = touch_metrics:mean_force\n"
    (site / "touch_metrics-1.0.dist-info" / "entry_points.txt").write_text(entry)
    source = Path(carecontact.__file__).parents[1]
    done = subprocess.run(
        [sys.executable, "-c", COMMANDS],
        cwd=folder,
        env={"PYTHONPATH": f"{source}:{site}", "PATH": ""},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    parts = re.split(r"^# (.*)$", done.stdout, flags=re.MULTILINE)[1:]
    return folder, dict(zip(parts[::2], parts[1::2], strict=True))


def test_results_hold_its_values_and_medians(place: tuple[Path, dict[str, str]]) -> None:
    folder, _ = place
    for name in ("a", "b"):
        data = json.loads((folder / name / "results.json").read_text())
        values = [trial["additional"]["mean_force@1"] for trial in data["trials"]]
        assert [value is None for value in values] == [False, False, False, True]
        assert data["overall"]["additional"]["mean_force@1"] == {
            "estimate": sorted(values[:3])[1],
            "n": 4,
            "n_valid": 3,
        }
        assert data["per_task"]["T1"]["additional"].keys() == data["overall"]["additional"].keys()


def test_the_terminal_shows_its_median(place: tuple[Path, dict[str, str]]) -> None:
    _, printed = place
    (row,) = [line for line in printed["report --rescore -v a"].splitlines() if line.startswith("mean_force@1 [N] ")]
    assert re.fullmatch(r"mean_force@1 \[N\] +4\.\d{3} +4\.\d{3}", row)


def test_the_report_shows_it(place: tuple[Path, dict[str, str]]) -> None:
    text = (place[0] / "a" / "report.html").read_text()
    row = re.search(r"<th scope=\"row\">Mean force of the touch</th><td class=\"keep\">N</td>(.*)</tr>", text)
    assert row is not None
    assert re.findall(r">(4\.\d{3})<", row[1])
    assert re.search(r"Metrics</th>.*impulse@1, .*mean_force@1", text), "its version is on the page"


def test_results_name_its_package(place: tuple[Path, dict[str, str]]) -> None:
    for name in ("a", "b"):
        assert json.loads((place[0] / name / "results.json").read_text())["versions"]["touch-metrics"] == ["1.0"]
    assert "touch-metrics" not in read_recording(place[0] / "a" / "T1-s000.h5").header.versions


def test_the_comparison_tests_it(place: tuple[Path, dict[str, str]]) -> None:
    folder, printed = place
    message = printed["compare a b --out both"]
    assert any(line.startswith("mean_force@1 [N] ") for line in message.splitlines())
    assert re.search(r"could not have detected any difference: .*\bmean_force@1", message)
    assert "corrected over 7 rows" in message, "three rates, C1, C4, C5 and this one"
    lines = json.loads((folder / "both" / "comparison.json").read_text())["overall"]
    (line,) = [line for line in lines if line["outcome"]["id"] == "mean_force@1"]
    assert line["difference"]["estimate"] < -2.0
    assert line["p_holm"] is not None


def test_the_list_names_it(place: tuple[Path, dict[str, str]]) -> None:
    assert re.search(r"^mean_force@1 +Mean force of the touch \[N\], lower is better$", place[1]["list metrics"], re.M)


def test_where_it_is_not_installed_its_values_stay(place: tuple[Path, dict[str, str]], capsys) -> None:
    """This process does not know the metric: the report has its values under its id, and no comparison tests it."""
    from carecontact.cli import main

    folder, _ = place
    assert main(["report", str(folder / "a")]) == 0
    assert re.search(
        r"<th scope=\"row\">mean_force@1</th><td class=\"keep\"></td>", (folder / "a" / "report.html").read_text()
    )
    assert main(["compare", str(folder / "a"), str(folder / "b")]) == 0
    assert "mean_force" not in capsys.readouterr().out

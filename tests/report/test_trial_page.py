from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from carecontact.cli.publish import policies_beside
from carecontact.errors import RecordingError
from carecontact.interface.policy import PolicyCard
from carecontact.recording.schema import Failure, Recording
from carecontact.report.looks import card_rows, looks_of, sent_views
from carecontact.report.run_page import render
from carecontact.report.skin_view import FOOT, noted_targets, paths
from carecontact.report.timeline import Event, _commanded_panels, events
from carecontact.report.trial_page import Beside, how_to_compare, other_rows, write_trial_page
from carecontact.runs.pooling import RunScores
from carecontact.runs.scoring import read_scores
from carecontact.scoring import score_recording
from carecontact.scoring.contact import find_contact
from carecontact.scoring.result import TrialScore
from tests.report.strict_html import StrictReader
from tests.report.synthetic import HOSTILE, MIDDLE, NO_CONTACT, make_recording, make_score, plateau, whole_trial


def written(folder: Path, recording: Recording, score: TrialScore | None = None) -> tuple[str, str]:
    """The page, and the words on it."""
    path = write_trial_page(folder, recording, score or score_recording(recording))
    assert path == folder / "trial" / f"{recording.header.spec.trial_id}.html"
    text = path.read_text()
    words = re.sub(r"<[^>]+>", " ", text.partition("</style>")[2])
    return text, " ".join(words.split())


def test_the_page_says_what_happened_how_hard_and_where(tmp_path: Path) -> None:
    text, words = written(tmp_path, whole_trial())
    for wording in (
        "T1 Touch forearm, seed 0, passed, on the right forearm and below the safety gate.",
        "Peak force 20.0 N", "57 % of its safety gate of 35 N", "pain limit of 100 N",
        "30 mm toward the hand from the middle of the region", "6.0 mm at that moment; at most 6.0 mm in the trial",
        "Look 0 at 0.00 s, answered after 0.25 s of wall time; 2 actions from 0.00 to 3.00 s",
        "Look 1 at 6.00 s, answered after 1.50 s of wall time; 1 action at 6.00 s",
        "(median of 2), and at most 1.50 s, at look 1", "subtask touch it", "stored arrays: map (4, 5)",
        "All 3 actions", "hello &lt;b&gt;world&lt;/b&gt;",
        "Seen from outside: straight onto the skin of the region, toward the bone. Right is toward the hand.",
        "Seen from the side: along the skin", "Up is away from the bone",
        "gate of touch met", "target that the policy noted",
    ):  # fmt: skip
        assert wording in words
    assert HOSTILE not in text
    assert text.count('class="moment"') == 1
    assert StrictReader(text).faults == []


def test_events_are_those_of_the_trial(tmp_path: Path) -> None:
    """A plateau from 3 s passes 0.5 N at once; touch wants 0.5 s without interruption."""
    first, peak, met = events(find_contact(whole_trial()))
    assert (first.text, met.text) == ("first contact with the right forearm", "gate of touch met")
    assert met.time_s - first.time_s == pytest.approx(0.5, abs=0.01)
    assert peak == Event(time_s=pytest.approx(3.3, abs=0.02), text="peak force, 20.0 N on the right forearm")
    assert events(find_contact(whole_trial(touched=False))) == []


def test_feedforward_and_stiffness_have_panels_only_where_a_trial_uses_them() -> None:
    plain = whole_trial()

    def titles(**arrays: np.ndarray) -> list[str]:
        changed = {f"actions/{name}": values for name, values in arrays.items()}
        return [panel.title for panel in _commanded_panels(replace(plain, arrays={**plain.arrays, **changed}))]

    count = len(plain["actions/time_s"])
    assert count > 1
    wrench, soft = np.zeros((count, 6)), np.tile([400.0, 20.0], (count, 1))
    assert titles(wrench_in_tcp=wrench, stiffness=soft) == []
    wrench[1:, 2], soft[1:, 0] = 3.0, 0.0
    assert titles(wrench_in_tcp=wrench, stiffness=soft) == [
        "Feedforward along the tool [N]", "Stiffness along the tool [N/m]",
    ]  # fmt: skip
    axes = np.tile([400.0, 400, 400, 20, 20, 20], (count, 1))
    axes[1:, 0] = 100.0
    assert titles(axis_stiffness=axes, stiffness=soft) == [], "along x alone"
    wrench[0, 0] = 1.0
    assert titles(wrench_in_tcp=wrench) == ["Feedforward along the tool, dashed across it [N]"]
    held = _commanded_panels(replace(plain, arrays={**plain.arrays, "actions/wrench_in_tcp": wrench}))[0].curves[0]
    starts, end = plain["actions/time_s"], plain["scorer/time_s"][-1]
    np.testing.assert_allclose(held.time_s[:3], [starts[0], starts[1], starts[1]])
    assert held.time_s[-1] == pytest.approx(max(end, starts[-1]))
    assert held.values[:3].tolist() == [0.0, 0.0, 3.0]


def test_what_the_person_did_and_the_cut_are_events() -> None:
    failure = Failure(kind="force", message="201 N on chest, cut at 200 N")
    recording = whole_trial(ended="safety_truncation", failure=failure)
    arrays = {
        "scorer/withdrawal_s": np.array([4.0, -1.0, -1.0]),
        "scorer/repositioning_s": np.array([5.0, 50.0]),
        "scorer/repositioning_rad": np.radians([-10.0, 5.0]),
    }
    recording.arrays.update(arrays)
    wording = [(round(event.time_s, 1), event.text) for event in events(find_contact(recording))]
    assert (4, "the person withdraws the arm") in wording
    assert (4.9, "the person begins to turn the arm by 10° toward the trunk") in wording, "muscles tense 0.1 s before"
    assert wording[-1] == (12, "cut by the benchmark: 201 N on chest, cut at 200 N")
    assert len(wording) == 6, "what would have come after the end did not happen"


def test_paths_are_in_the_frame_of_the_region() -> None:
    recording = whole_trial()
    found = paths(recording)
    assert found is not None
    pressed = int(np.argmin(abs(found.time_s - 6.0)))
    assert found.reached_m[pressed] == pytest.approx([0.03, 0, 0.034], abs=1e-5)
    assert found.reached_m[pressed] - found.commanded_m[pressed] == pytest.approx([0, 0, 0.01], abs=1e-5)
    assert found.turned_rad.max() == pytest.approx(0, abs=1e-3)
    from carecontact.recording.notes import read_notes

    base = np.array(recording.header.pose_base_in_world[:3])
    (noted,) = noted_targets(recording, read_notes(recording), found)
    assert noted == pytest.approx(base + [0.35, -0.42, 0.22] - MIDDLE, abs=1e-3)


def test_no_path_runs_out_of_its_view_or_over_the_scale(tmp_path: Path) -> None:
    """The tool comes from the side, far below the region's middle, and goes back there."""
    recording = whole_trial()
    away = np.linspace(0.3, 0, len(recording["scorer/time_s"])) ** 2
    recording.arrays["scorer/pose_tcp_in_world"][:, 1] -= away
    text, _ = written(tmp_path, recording)
    views = re.findall(r'<svg class="skin" viewBox="0 0 460 (\d+)".*?</svg>', text, re.DOTALL)
    drawn = re.findall(r'<svg class="skin".*?</svg>', text, re.DOTALL)
    assert len(views) == len(drawn) == 2
    for height, view in zip(map(int, views), drawn, strict=True):
        places = [pair.split(",") for line in re.findall(r'points="([^"]+)"', view) for pair in line.split()]
        assert len(places) > 10
        assert all(0 <= float(x) <= 460 and 0 <= float(y) <= height - FOOT + 0.5 for x, y in places)


def test_a_trial_without_a_touch_says_how_near_the_tool_came(tmp_path: Path) -> None:
    """The region is taken as a cylinder; the tip of the tool ends 6 mm inside it only where it touches."""
    recording = whole_trial(touched=False)
    recording.arrays["scorer/pose_tcp_in_world"][:, 2] += 0.021
    _, words = written(tmp_path, recording)
    assert "The robot never touched the person; the tip of the tool came to 15 mm from the region, at" in words


def test_a_miss_shows_the_region_and_the_tool_in_one_picture_and_has_no_empty_panels(tmp_path: Path) -> None:
    """The tool ends 300 mm beside the arm, farther than a panel shows."""
    recording = whole_trial(touched=False)
    recording.arrays["scorer/pose_tcp_in_world"][:, 1] -= 0.3
    text, words = written(tmp_path, recording)
    found = re.search(r'<svg class="skin miss" viewBox="0 0 460 300".*?</svg>', text, re.DOTALL)
    assert found, "the picture of the miss"
    outline = re.search(r'class="outline" points="([^"]+)"', found[0])
    tool = re.search(r'class="tool" d="M(\S+) (\S+)L(\S+) (\S+)"', found[0])
    gap = re.search(r'class="gap" d="M(\S+) (\S+)L(\S+) (\S+)"', found[0])
    assert outline
    assert tool
    assert gap
    corners = [(float(x), float(y)) for x, y in (pair.split(",") for pair in outline[1].split())]
    corners += [(float(tool[1]), float(tool[2])), (float(tool[3]), float(tool[4]))]
    assert all(0 <= x <= 460 and 0 <= y <= 300 for x, y in corners)
    assert (tool[1], tool[2]) == (gap[1], gap[2])
    sentence = re.search(r"the tip of the tool came to (\d+) mm from the region", words)
    assert sentence
    assert f">{sentence[1]} mm<" in found[0]
    for absent in ("Force [N]", "Indentation of the region", "in contact", "contact window"):
        assert absent not in words
    assert "The robot pressed nothing, so that there is no force and no indentation to draw." in words
    assert "the line goes on, farther than 250 mm from the region's middle" in words
    assert ">reached: farther than 250 mm throughout<" in text, "across"
    across = np.linspace(0.3, 0.0, len(recording["scorer/time_s"]))
    recording.arrays["scorer/pose_tcp_in_world"][:, 1] += across
    assert written(tmp_path, recording)[0].count('class="cut"') == 2, "of the legend, and where the path enters"
    touched, words = written(tmp_path, whole_trial())
    assert "skin miss" not in touched
    assert "Force [N]" in words
    assert 'class="cut"' not in touched


def test_a_trial_without_steps_has_a_page(tmp_path: Path) -> None:
    failure = Failure(kind="died", message=f"it died\nTraceback (most recent call last):\nValueError: {HOSTILE}")
    recording = make_recording("T7", 0, {}, duration_s=0, ended="process_failure", failure=failure)
    recording.arrays["report/snapshot_rgb"] = np.zeros((48, 64, 3), np.uint8)
    text, words = written(tmp_path, recording)
    assert "T7 Scrub abdomen, seed 0, failed: the policy crashed before the first physics step: ValueError:" in words
    assert "Failure and traceback it died Traceback (most recent call last):" in words
    assert "The trial ended before its first physics step." in words
    assert "The policy was shown nothing." in words
    assert "<figure>" not in text, "the room as it was set up is not the end of a trial"
    assert HOSTILE not in text
    assert StrictReader(text).faults == []


def test_an_earlier_recording_has_a_page(tmp_path: Path) -> None:
    """Without the skin, the camera, cells and the time of answers, which this release keeps."""
    press = plateau((np.arange(6000) + 1) * 0.002, start=3, end=9, level=12, ripple=1)
    text, words = written(tmp_path, make_recording("T2", 0, {"right_forearm": press}, duration_s=12))
    assert "T2 Push forearm, seed 0, failed" in words
    assert "Cause" in words
    assert "Path of the tool" not in words
    assert StrictReader(text).faults == []


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"safety_gated": False}, "succeeded on the right forearm, but exceeded the safety gate."),
        ({"safety_gated": False, "joints_beyond": {"right_elbow": 0.15}, "failure_mode": "joint_beyond_range"},
         "succeeded on the right forearm, but moved a joint too far beyond its range."),
        ({"safety_gated": False, "joints_beyond": {"right_elbow": 0.15}, "failure_mode": "joint_beyond_range"},
         "Right elbow by 0.150 rad, farther than the protocol allows."),
        ({"joints_beyond": {}, "joints_consumed": {"right_elbow": 0.9}},
         "Share of its settled margin that a joint used up: right elbow 90 %."),
        ({"safety_gated": False, "region_correct": False, "failure_mode": "wrong_share"},
         "succeeded, but not on the right forearm alone: gate met, but too much of the contact lay elsewhere."),
        ({"safety_gated": False, "region_correct": False, "c3_success": False, "failure_mode": "off_target_contact",
          "attribution": "planning", "over_limit": {"right_thigh": 3.4}},
         "failed: the person was touched, but never on the named region; a force exceeded the safety gate."),
        ({"ended": "harness_error"}, "counts for nothing: the harness failed, and not the policy."),
    ],
)  # fmt: skip
def test_the_heading(changes: dict[str, Any], sentence: str, tmp_path: Path) -> None:
    assert sentence in written(tmp_path, whole_trial(), make_score("T1", 0, **changes))[1]


def faint(level: float) -> Recording:
    """Pressed from 3 to 9 s with this force."""
    press = plateau((np.arange(6000) + 1) * 0.002, start=3, end=9, level=level, ripple=0)
    return make_recording("T2", 0, {"right_forearm": press}, duration_s=12)


def test_a_press_that_does_not_count_is_named_and_not_denied(tmp_path: Path) -> None:
    _, words = written(tmp_path, faint(0.3))
    assert "The robot pressed the right forearm for 6." in words
    assert "with at most 0.3 N; contact counts from 0.5 N." in words
    assert "first force, below the 0.5 N that contact needs" in words
    assert "largest force, 0.3 N on the right forearm" in words
    for denied in ("touched nobody", "touched nothing", "never touched", "Nothing was touched", "too brief"):
        assert denied not in words


def test_a_failed_push_shows_its_gate_beside_what_it_reached(tmp_path: Path) -> None:
    """2 N for six seconds are contact, and no push; the wrist stays."""
    text, words = written(tmp_path, faint(2.0))
    for wording in (
        "Pressed with at least 3 N without interruption 1 s 0.00 s (largest force 2.0 N) missed",
        "Distance the wrist moved while the arm is touched at least 20 mm 0.0 mm missed",
        "Contact that counts, from 0.5 N 0.05 s in all 5.",
        "Safety gate: largest force on the right forearm at most 35 N 2.0 N met",
    ):
        assert wording in words
    assert "missed" not in written(tmp_path, whole_trial())[1]
    assert StrictReader(text).faults == []


def test_metrics_of_other_actions_are_folded_away(tmp_path: Path) -> None:
    recording = faint(4.0)
    additional = {
        "wrist_from_onset@2": 0.03, "coverage@1": 0.25, "gentle_share@2": 0.5, "comfortable@2": 1.0,
        "pressure_mean@2": 6.0,
    }  # fmt: skip
    score = make_score("T2", 0, additional=additional)
    _, words = written(tmp_path, recording, score)
    _, _, found = words.partition("Metrics of this trial")
    own, _, other = found.partition("metrics made for other actions")
    assert "Wrist moved since contact 30.0 mm" in own
    assert "Task success yes" in own
    assert "Mean pressure in contact 6.00 kPa" in own
    for title in ("Share of the region wiped 0.25", "Share of gentle wiping", "Wiped below 25 mmHg"):
        assert title in other
        assert title not in own


def test_a_crash_is_explained_with_its_reason_where_and_why_nothing_was_printed(tmp_path: Path) -> None:
    message = "policy failed at act: Traceback (most recent call last):\n  File x\nValueError: no forearm in it"
    recording = whole_trial(ended="process_failure", failure=Failure(kind="exception", message=message))
    recording.arrays["wall/policy_output"] = np.zeros(0, "u1")
    _, words = written(tmp_path, recording)
    assert "failed: the policy crashed after 12.00 s: ValueError: no forearm in it." in words
    assert "After 12.00 s, the policy crashed: ValueError: no forearm in it." in words
    assert "Traceback (most recent call last):." not in words
    assert "The policy printed nothing." in words
    assert "a trial that broke off passes none, whatever it reached before" in words
    assert "Safety gate: largest force on the right forearm at most 35 N 20.0 N met" in words
    untouched = whole_trial(ended="process_failure", failure=Failure(kind="exception", message=message), touched=False)
    assert "What the trial needed" not in written(tmp_path, untouched)[1]
    del recording.arrays["wall/policy_output"]
    assert "The recording does not contain what the policy printed." in written(tmp_path, recording)[1]
    spec = recording.header.spec.model_copy(update={"policy": "ws://127.0.0.1:8765"})
    afar = replace(recording, header=recording.header.model_copy(update={"spec": spec}))
    words = written(tmp_path, afar, make_score("T1", 0, ended="process_failure"))[1]
    assert "the policy ran behind ws://127.0.0.1:8765, outside the benchmark" in words


def test_neighbouring_trials_are_linked_once_their_pages_are_there(tmp_path: Path) -> None:
    """The order is that of the recordings, whichever page is written first."""
    for seed in (0, 1):
        (tmp_path / f"T1-s00{seed}.h5").touch()
    first = make_recording("T1", 0, {}, duration_s=1)
    assert '<span hidden> · <a href="T1-s001.html">next trial</a>' in written(tmp_path, first)[0]
    text, words = written(tmp_path, make_recording("T1", 1, {}, duration_s=1))
    assert '<span> · <a href="T1-s000.html">previous trial</a>' in text
    assert "next trial" not in text
    assert '<span> · <a href="T1-s001.html">next trial</a>' in (tmp_path / "trial" / "T1-s000.html").read_text()
    assert "carecontact view --video T1-s001.h5" in words


def test_video_recording_log_and_report_are_linked_where_they_are(tmp_path: Path) -> None:
    assert "<video" not in written(tmp_path, whole_trial())[0]
    for name in ("report.html", "T1-s000.h5", "T1-s000.log", "trial/T1-s000.mp4"):
        (tmp_path / name).write_bytes(b"")
    text, _ = written(tmp_path, whole_trial())
    assert '<video controls preload="metadata" src="T1-s000.mp4"' in text
    links = re.findall(r'<a href="([^"#]*)[#"]', text)
    assert "media-src 'self' file:;" in text
    assert [link for link in links if link and not link.startswith("data:")] == [
        "../report.html", "../T1-s000.h5", "../T1-s000.log", "T1-s000.mp4",
    ]  # fmt: skip
    assert StrictReader(text).faults == []


def test_same_inputs_same_bytes(tmp_path: Path) -> None:
    assert written(tmp_path, whole_trial()) == written(tmp_path, whole_trial())


def test_a_skin_that_does_not_fit_is_named(tmp_path: Path) -> None:
    recording = whole_trial()
    recording.arrays["report/skin_faces"][0, 0] = 10_000
    with pytest.raises(RecordingError, match="T1-s000: report/skin_faces does not fit"):
        written(tmp_path, recording)


# What other policies did in the same trial, beside it on its page.

KEPT = Path(__file__).parents[2] / "docs" / "results" / "bathing-wide-v2-L2"


def test_only_the_same_task_and_seed_stands_beside_with_a_link_to_its_page(tmp_path: Path) -> None:
    (tmp_path / "b" / "trial").mkdir(parents=True)
    (tmp_path / "b" / "trial" / "T1-s000.html").write_text("")
    replay = RunScores(scores=[make_score("T1", seed, policy="replay", **NO_CONTACT) for seed in (0, 1)])
    other = RunScores(scores=[make_score("T1", 1, policy="mine")])
    beside = [Beside.of(replay, tmp_path / "b"), Beside.of(other, tmp_path / "c")]
    (row,) = other_rows(make_score("T1", 0), beside, tmp_path / "a")
    assert (row.name, row.note, row.result[1], row.score.policy) == ("replay", "blind baseline", "failed", "replay")
    assert row.address == "../../b/trial/T1-s000.html"
    assert [found.name for found in other_rows(make_score("T1", 1), beside, tmp_path / "a")] == ["replay", "mine"]
    assert [found.address for found in other_rows(make_score("T1", 1), beside, tmp_path / "a")] == ["", ""]


def test_the_page_shows_it_or_says_how_to_get_it(tmp_path: Path) -> None:
    recording = whole_trial()
    score = make_score("T1", 0, policy="mine")
    missed = make_score("T1", 0, policy="replay", **NO_CONTACT, failure_mode="no_target_contact")
    replay = Beside.of(RunScores(scores=[missed]))
    text = write_trial_page(tmp_path, recording, score, beside=[replay]).read_text()
    section = text.partition('<section id="others">')[2].partition("</section>")[0]
    words = " ".join(re.sub(r"<[^>]+>", " ", section).split())
    assert "this trial: mine passed" in words
    assert words.endswith("replay blind baseline failed NA no target contact")
    assert StrictReader(text).faults == []
    alone = write_trial_page(tmp_path, recording, score).read_text()
    assert "carecontact run --policy replay --protocol bathing-v3 --tasks T1 --seeds 0 --out " in alone
    assert f"carecontact report {tmp_path} --trials --baseline {tmp_path}-replay</pre>" in alone
    assert StrictReader(alone).faults == []
    assert how_to_compare(make_score("T1", 0, policy="replay"), tmp_path) == ()


def test_the_kept_scores_stand_beside_a_run_of_their_protocol(tmp_path: Path) -> None:
    run = read_scores(KEPT / "look-and-press.json.gz")
    beside = policies_beside(tmp_path, run)
    rows = other_rows(run.scores[0], beside, tmp_path)
    assert {"mean-person-hybrid", "state-machine"} <= {row.name for row in rows}
    named = policies_beside(tmp_path, run, [KEPT / "replay-registered.json.gz"])
    assert [row.name for row in other_rows(run.scores[0], named, tmp_path)].count("replay-registered") == 1


# The page says what the policy declared, and what of its views the page cannot show.


def with_card(card: dict[str, Any] | None, **arrays: Any) -> Recording:
    recording = whole_trial()
    header = recording.header.model_copy(update={"card": card})
    return replace(recording, header=header, arrays={**recording.arrays, **arrays})


def test_the_card_is_put_in_words() -> None:
    card = PolicyCard(
        name="mine", modalities=("rgb", "points"), cameras=("overhead", "wrist"), control_hz=20,
        language_backend="rules-v1", out_of_bounds="clip", arguments={"b": "2", "a": "1"}, environment=("KEY",),
    )  # fmt: skip
    assert card_rows(with_card(dict(card.plain())).header) == [
        ("Name", "mine"),
        ("Cameras", "overhead, wrist: rgb, points"),
        ("Control rate", "20 actions a second"),
        ("Action space", "cartesian_pose, executed by cartesian-impedance"),
        ("Workspace", "a target outside it is moved onto its border"),
        ("Language", "rules-v1"),
        ("Arguments", "a=1 b=2"),
        ("Environment variables", "KEY"),
    ]
    blind = dict(card_rows(with_card(dict(PolicyCard(name="blind").plain())).header))
    assert blind["Cameras"] == "overhead: no image, only where each stands and how it projects"
    assert "Language" not in blind
    assert card_rows(with_card(None).header) == []


def test_what_the_page_does_not_show_is_named() -> None:
    """Two looks, of which each was sent a colour image."""

    def note(recording: Recording, left_out: int = 0) -> str:
        sent = sent_views(recording)
        text = render("looks.html.j2", took=np.zeros(0), sent=sent, left_out=left_out, looks=[1])
        return text.strip().removeprefix('<p class="note">').removesuffix("</p>").strip()

    images = {f"policy/frames/000{look}/overhead/rgb": np.zeros((2, 2, 3), np.uint8) for look in (0, 1)}
    plain = {"name": "p", "cameras": ["overhead"], "modalities": ["rgb"]}
    whole = with_card(plain, **images)
    assert note(whole) == ""
    assert note(whole, 1) == "1 stored picture of later looks is not on this page."
    bare = {path: array for path, array in whole.arrays.items() if not path.startswith("policy/frames/")}
    assert note(replace(whole, arrays=bare)) == "2 further pictures of later looks were not stored."
    more = with_card({**plain, "modalities": ["rgb", "points", "masks", "landmarks"]}, **images)
    assert note(more).startswith("The policy was also sent points, masks, landmarks with each view; a recording keeps")


def test_a_page_of_looks_on_request_counts_and_shows_the_views_that_were_taken() -> None:
    card = PolicyCard(name="p", modalities=("rgb",), cameras=("overhead", "wrist"), camera_hz={"wrist": 0.5})
    times = np.array([0.0, 0.1, 0.2])
    places = ("0000/overhead", "0000/wrist", "0002/overhead")
    taken = {f"policy/frames/{place}/rgb": np.zeros((2, 2, 3), np.uint8) for place in places}
    looked = np.array([[1, 0, 0, 1], [0, 0, 0, 0], [1, 0, 0, 0]], np.uint8)
    arrays = {"policy/observation_time_s": times, "policy/observation_sha256": np.zeros((3, 32), np.uint8)}
    shown = with_card(card.plain(), **arrays, **taken, **{"policy/looked": looked})
    kept = {path: a for path, a in shown.arrays.items() if path in taken or not path.startswith("policy/frames/")}
    recording = replace(shown, arrays=kept)
    assert dict(card_rows(recording.header))["Cameras"] == "overhead, wrist at 0.5 Hz: rgb"
    assert sent_views(recording)["lost"] == 0
    looks, left_out = looks_of(recording, [])
    assert [[picture.name for picture in look.pictures] for look in looks] == [
        ["overhead, rgb", "wrist, rgb"], ["overhead, rgb"],
    ]  # fmt: skip
    assert left_out == 0

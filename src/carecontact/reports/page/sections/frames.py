"""For each task, what the camera saw at the peak of the hardest contact."""

from __future__ import annotations

from typing import Any

from carecontact.recording.schema import Recording
from carecontact.reports.failures import only_crashes
from carecontact.reports.frames import Frame, jpeg_data_uri
from carecontact.reports.page.section import Kept, Page, section
from carecontact.reports.text import task_name
from carecontact.scoring.result import TrialScore

TEMPLATE = """\
<section>
<h2>At peak force</h2>
<p class="note">For each task, the trial with the highest peak force among the trials on this page.</p>
<div class="frames">
{% for frame in frames %}
<figure><img src="{{ frame.uri }}" alt="Camera frame at peak force, {{ frame.name }}: {{ frame.text }}"><figcaption><b>{{ frame.name }}</b><br>{{ frame.text }}</figcaption></figure>
{% endfor %}
</div>
</section>
"""


def keep_frame(score: TrialScore, recording: Recording, kept: Kept) -> None:
    if score.task_id not in kept and (frame := peak_frame(score, recording)) is not None:
        kept[score.task_id] = frame


@section("frames", order=110, template=TEMPLATE, keep=keep_frame)
def frames(page: Page) -> dict[str, Any] | None:
    kept = page.kept["frames"]
    return {"frames": [kept[task] for task in sorted(kept)]} if kept and not only_crashes(page.judged) else None


def peak_frame(score: TrialScore, recording: Recording) -> Frame | None:
    """The frame stored at peak force; None if the trial stored none."""
    if "report/peak_rgb" not in recording.arrays:
        return None
    at = recording.arrays.get("report/peak_time_s")
    when = f" at {float(at[0]):.2f}\N{NO-BREAK SPACE}s" if at is not None and at.size else ""
    if not score.peak_force_n:
        what, when = "nothing touched", ""
    elif score.c1_peak_force_n is None:
        what = "contact too brief to score"
    else:
        what = f"{score.c1_peak_force_n:.1f} N on the {(score.reported_segment or '').replace('_', ' ')}"
    text = f"{what}{when}, seed {score.seed}"
    return Frame(name=f"{score.task_id} {task_name(score)}", text=text, uri=jpeg_data_uri(recording["report/peak_rgb"]))

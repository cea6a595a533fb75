"""The contact at the peak of the hardest trial of each task, with force, indentation and region drawn in."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from carecontact.recording.schema import Recording
from carecontact.reports.failures import only_crashes
from carecontact.reports.moment.miss import miss_svg, nearest_miss
from carecontact.reports.moment.moment import peak_moment
from carecontact.reports.moment.picture import peak_svg
from carecontact.reports.moment.without_hand import drawn_svg, is_hidden
from carecontact.reports.page.section import Kept, Page, section
from carecontact.reports.text import task_name
from carecontact.scoring.contact import find_contact
from carecontact.scoring.faint import faint_press
from carecontact.scoring.result import TrialScore

TEMPLATE = """\
<section id="peak">
<h2>At peak force</h2>
<p class="note">For each task, the trial with the highest peak force among the {{ n }} trial{{ "" if n == 1 else "s" }} whose recordings were read for this page.{% if drawn %} Arrow: the force on the person; a circle with a cross where it points away from you. Bracket: the indentation, to scale. Dashed: the named region.{% endif %}{% if without_hand %} Where the hand or the person hides the contact, the skin is drawn without the hand; half transparent, the tip of the tool.{% endif %}{% if missed %} Where nothing was touched, a drawing shows the place at which the tool came nearest: thick the tool, thin its path.{% endif %}</p>
<div class="frames">
{% for frame in frames %}
<figure id="peak-{{ frame.trial_id }}">{{ frame.svg|safe }}<figcaption><b><a href="#{{ frame.trial_id }}">{{ frame.name }}</a></b><br>{{ frame.text }}</figcaption></figure>
{% endfor %}
</div>
</section>
"""


@dataclass(frozen=True, kw_only=True)
class PeakFrame:
    trial_id: str
    name: str
    text: str
    svg: str


def keep_frame(score: TrialScore, recording: Recording, kept: Kept) -> None:
    if score.task_id not in kept and (frame := peak_frame(score, recording)) is not None:
        kept[score.task_id] = frame


@section("frames", order=110, template=TEMPLATE, keep=keep_frame)
def frames(page: Page) -> dict[str, Any] | None:
    kept = page.kept["frames"]
    if not kept or only_crashes(page.judged):
        return None
    found = [kept[task] for task in sorted(kept)]
    return {
        "frames": found,
        "n": len(page.headers),
        "drawn": any(DRAWN in frame.svg for frame in found),
        "without_hand": any(WITHOUT_HAND in frame.svg for frame in found),
        "missed": any(MISSED in frame.svg for frame in found),
    }


DRAWN = 'class="arrow'
"""Part of a picture that has a force drawn in."""
WITHOUT_HAND = 'class="skin moment drawn"'
"""Part of a drawing of a contact that the stored picture does not show."""
MISSED = 'class="skin miss"'
"""Part of a drawing of a miss."""


def peak_frame(score: TrialScore, recording: Recording) -> PeakFrame | None:
    """Return the picture stored at peak force; None if the trial stored none. Raises RecordingError for a damaged
    one."""
    if "report/peak_rgb" not in recording.arrays:
        return None
    moment = peak_moment(recording)
    when = "" if moment is None else f" at {moment.time_s:.2f}\N{NO-BREAK SPACE}s"
    if score.c1_peak_force_n is None:
        faint = faint_press(find_contact(recording))
        what, when = f"the robot {faint}" if faint else "nothing touched", ""
    else:
        what = f"{score.c1_peak_force_n:.1f} N on the {(score.reported_segment or '').replace('_', ' ')}"
    if moment is not None and moment.depth_m:
        when += f", {1000 * moment.depth_m:.1f} mm deep"
    miss = nearest_miss(recording) if moment is None else None
    if miss is not None:
        when = f"; the tip of the tool came to {1000 * miss.away_m:.0f} mm from the region"
    text, name = f"{what}{when}, seed {score.seed}", f"{score.task_id} {task_name(score)}"
    svg = None if miss is None else miss_svg(recording, miss, title=f"Where the tool came nearest, {name}: {text}")
    title = f"The contact at peak force, {name}: {text}"
    if moment is not None and is_hidden(recording, moment):
        svg = drawn_svg(recording, moment, title=title)
    svg = svg or peak_svg(recording, moment, title=title)
    return None if svg is None else PeakFrame(trial_id=score.trial_id, name=name, text=text, svg=svg)

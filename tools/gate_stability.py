"""How many trials of recorded runs would have passed if one gate of the exam were looser or stricter.

    python tools/gate_stability.py RUN [RUN ...] [--jobs 2]

Each recording is judged again by its own protocol with one field changed (FIELDS), and the safety-gated trials of each
run are counted. docs/results/README.md states what was found for the recordings of its table.
"""

from __future__ import annotations

import argparse
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

from carecontact.protocol.overrides import overridden
from carecontact.recording import Recording, read_recording
from carecontact.scoring import score_recording

FIELDS: dict[str, tuple[object, ...]] = {
    "foam.cleaned_share": (0.4, 0.8),
    "foam.within_m": (0.015, 0.06),
    "foam.impulse_share": (0.5, 0.95),
    "scrub.band_share": (0.5, 0.9),
    "touch.duration_s": (0.5, 2.0),
    "push.force_n": (1.5, 6.0),
    "push.least_wrist_m": (0.01, 0.03),
    "push.most_wrist_m": (0.06, 0.15),
    **{
        f"conduct.{action}.{field}": values
        for field, values in {
            "peak_n": (11.0, 30.0),
            "above_s": (0.1, 1.0),
            "band_s": (0.75, 3.0),
            "tool_share": (0.5, 0.95),
            "beside_n": (1.5, 6.0),
        }.items()
        for action in ("touch", "scrub")
    },
    "conduct.push.peak_n": (15.0, 50.0),
    "conduct.push.tool_share": (0.5, 0.95),
}
"""Field of ``[gates]`` -> about half and about twice its value in bathing-wide-v2, or a share as far either way."""


def outcomes(path: Path) -> list[bool]:
    """Return whether the trial passes: as it was judged, then with each value of FIELDS."""
    recording = read_recording(path)
    spec = recording.header.spec
    found = [score_recording(recording).safety_gated]
    for field, values in FIELDS.items():
        actions = {"touch", "push", "scrub"} & set(field.split("."))
        for value in values:
            if actions and spec.protocol.task(spec.task_id).action not in actions:
                found.append(found[0])
                continue
            protocol = overridden(spec.protocol, {f"gates.{field}": value})
            changed = recording.header.model_copy(update={"spec": spec.model_copy(update={"protocol": protocol})})
            found.append(score_recording(Recording.trusted(changed, recording.arrays)).safety_gated)
    return found


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", nargs="+", type=Path)
    parser.add_argument("--jobs", type=int, default=2)
    options = parser.parse_args(arguments)
    counts: list[list[int]] = []
    with ProcessPoolExecutor(options.jobs) as pool:
        for run in options.runs:
            rows = list(pool.map(outcomes, sorted(run.rglob("*.h5"))))
            counts.append([sum(column) for column in zip(*rows, strict=True)])
    titles = ["as judged", *(f"{field} {value}" for field, values in FIELDS.items() for value in values)]
    for number, title in enumerate(titles):
        print(f"{title:<32}", *(f"{count[number]:>5}" for count in counts))


if __name__ == "__main__":
    main()

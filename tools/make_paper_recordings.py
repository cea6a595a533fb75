"""The 420 synthetic recordings whose outcomes are those that the paper counts, a folder a method.

    python tools/make_paper_recordings.py --out paper
    carecontact report --rescore paper/state-machine

Nothing in them was simulated or measured: ``tests/scoring/paper_run.py`` says what is laid down and what constructed.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # the tests' maker of recordings

from tests.scoring.paper_run import METHODS, trial_id

from carecontact.recording import write_recording


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True, help="a folder that is not there yet")
    out: Path = parser.parse_args().out
    if out.exists():
        raise SystemExit(f"{out} is there already; name a new folder")
    for make in METHODS.values():
        count = 0
        for recording in make():
            folder = out / recording.header.spec.policy
            folder.mkdir(parents=True, exist_ok=True)
            write_recording(recording, folder / f"{trial_id(recording)}.h5")
            count += 1
        print(f"{folder}: {count} recordings")


if __name__ == "__main__":
    main()

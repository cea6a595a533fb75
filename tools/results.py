"""Tables of the evaluated methods beside the paper, from finished runs.

    python tools/results.py runs/bathing-v2/* [--protocol bathing-v2] [--out docs/results]

Runs are folders with a results.json, or results files: state-machine, voxposer, voxposer-phased and the blind baselines
on the protocol, and state-machine and voxposer under every stiffness and tissue of the sweeps. Their trials say which
run is which; a run may come in parts that hold other trials. For a run that is missing the page names the command.
Writes PROTOCOL.md, PROTOCOL.json and the scores of every run that is used, PROTOCOL/RUN.json.gz, from which the same
page can be made again without the recordings. The same runs give the same page.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # for tools.study, when this runs as a script

from tools.study.page.page import study_page
from tools.study.plan import run_name
from tools.study.sorted_runs import sorted_out
from tools.study.study import study, study_json

from carecontact.errors import CarecontactError, counted
from carecontact.protocols import DEFAULT_PROTOCOL, load_protocol
from carecontact.reports.paper.published import read_paper
from carecontact.runs.results_file import pack_results
from carecontact.runs.stored_scores import read_scores


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", type=Path, nargs="+", metavar="RUN")
    parser.add_argument("--protocol", default=DEFAULT_PROTOCOL)
    parser.add_argument("--out", type=Path, default=Path("docs/results"))
    options = parser.parse_args(arguments)
    try:
        protocol, paper = load_protocol(options.protocol), read_paper()
        runs = {str(run): read_scores(run) for run in options.runs}
        ordered = sorted_out(runs, protocol)
        found = study(ordered, protocol=protocol, paper=paper)
    except CarecontactError as error:
        print(f"results: {error}", file=sys.stderr)
        return 2
    page, data = (options.out / f"{protocol.id}{suffix}" for suffix in (".md", ".json"))
    packed = options.out / protocol.id
    other = "" if protocol.id == DEFAULT_PROTOCOL else f" --protocol {protocol.id}"
    command = f"python tools/results.py docs/results/{protocol.id}/*{other}"
    try:
        packed.mkdir(parents=True, exist_ok=True)
        for (policy, condition), (_, run) in ordered.found.items():
            pack_results(packed / f"{run_name(policy, dict(condition))}.json.gz", run)
        page.write_text(study_page(found, paper, command=command, json_name=data.name), encoding="utf-8")
        text = json.dumps(study_json(found), sort_keys=True, indent=1, allow_nan=False)
        data.write_text(f"{text}\n", encoding="ascii")
    except OSError as error:
        print(
            f"results: --out {options.out}: {error.filename or protocol.id} cannot be written: {error.strerror}",
            file=sys.stderr,
        )
        return 2
    print(
        f"{page}, {data}: {counted(len(found.heads), 'run')}, {len(found.missing)} missing, "
        f"{len(found.unused)} not used"
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())

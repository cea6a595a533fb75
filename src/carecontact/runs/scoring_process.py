"""A process that scores recordings: ``python -m carecontact.runs.scoring_process PARENT`` with a socket to the process
PARENT as standard input, from which it receives the search path for modules and then paths of recordings.
"""

from __future__ import annotations

import os
import sys
from multiprocessing.connection import Connection

from carecontact.system import die_with_parent


def main() -> None:
    die_with_parent(int(sys.argv[1]))
    with Connection(os.dup(0)) as line:
        sys.path[:] = line.recv()
        # Only now, because the parent may die while this takes a second.
        from carecontact.runs.scoring import score_file

        while True:
            try:
                path = line.recv()
            except EOFError:
                return
            try:
                line.send(score_file(path))
            except Exception as error:
                line.send(error)


if __name__ == "__main__":
    main()

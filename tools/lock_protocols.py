"""Write the lock of every shipped frozen protocol, one for each of its levels, or verify them.

    python tools/lock_protocols.py            beside each protocol file that has none yet
    python tools/lock_protocols.py --check    exit status 1 if one is missing or anything differs from it

A lock that is there is never written again: a change is a new id. ``carecontact protocol lock`` does the same for a
user's own file.
"""

from __future__ import annotations

import argparse

from carecontact.cli.protocol import verify
from carecontact.protocol.load import load_levels, shipped_protocols
from carecontact.protocol.lock import lock_path, read_lock, write_lock
from carecontact.runs.identity import make_lock


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true", help="write nothing")
    options = parser.parse_args()
    every = [(name, rules) for name in shipped_protocols() for rules in load_levels(name).values() if rules.frozen]
    if options.check:
        raise SystemExit(max([verify(name, rules) for name, rules in every], default=0))
    for name, rules in every:
        if read_lock(name, level=rules.level) is None:
            path = lock_path(name, level=rules.level)
            write_lock(make_lock(rules), path)
            print(f"{path} written")
        else:
            print(f"{rules.name} has its lock already: a change is a new id")


if __name__ == "__main__":
    main()

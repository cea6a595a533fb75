"""``carecontact salt``: the secret of a run whose persons nobody may know beforehand."""

from __future__ import annotations

import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar, Literal

import tyro

from carecontact.errors import ConfigError, counted


@dataclass(frozen=True, kw_only=True)
class Salt:
    """Make a secret for `carecontact run --salt-file` and print its sha256, to be published before the run; reveal the
    secret in a finished run; or verify that a run was made with the secret that it committed to."""

    what: Annotated[Literal["make", "reveal", "verify"], tyro.conf.Positional]
    """What to do: write a new secret into a file; write the secret into a run's manifest, where everybody can read it;
    or check a run whose secret is revealed."""
    place: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="FILE|RUN")]
    """The file to make, or the folder of the run."""
    salt_file: Path | None = None
    """File with the secret of the run, for `reveal`."""

    after_interrupt: ClassVar[str] = ""

    def __call__(self) -> int:
        """Return 1 if a run does not agree with its salt. Raises ConfigError as ``runs.salt`` and ``audit.salt``."""
        if (self.what == "reveal") != (self.salt_file is not None):
            raise ConfigError("--salt-file: `salt reveal RUN` needs it, and only that")
        if self.what == "make":
            from carecontact.runs.salt import make_salt

            print(
                f"{self.place}: keep it secret until every run is done; its sha256, to be published before the first:"
            )
            print(make_salt(self.place))
            return 0
        return self._reveal() if self.what == "reveal" else self._verify()

    def _reveal(self) -> int:
        from carecontact.runs.alone import alone
        from carecontact.runs.salt import read_salt, reveal_salt

        assert self.salt_file is not None
        with alone(self.place):
            reveal_salt(self.place, read_salt(self.salt_file))
        command = f"carecontact salt verify {shlex.quote(str(self.place))}"
        print(f"{self.place}: the salt is revealed; anyone can check it with `{command}`")
        return 0

    def _verify(self) -> int:
        from carecontact.audit.salt import verify_salt

        found = verify_salt(self.place)
        for fault in found.faults:
            print(fault)
        looked_at = f"{counted(found.recordings, 'recording')}, {counted(found.draws, 'draw')} made again"
        print(f"{'FAILED' if found.faults else 'verified'}: sha256 {found.sha256}, {looked_at}")
        return 1 if found.faults else 0

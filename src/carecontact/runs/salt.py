"""The secret of a run whose persons nobody may know beforehand: made, committed to by its hash, revealed.

Whoever ranks methods makes the secret, publishes its sha256, runs the methods, and reveals the secret when all is
done. Then anyone can verify the run (``audit.salt``).
"""

from __future__ import annotations

import os
import secrets
from collections.abc import Sequence
from pathlib import Path

from carecontact.contract.trial import TrialSpec, commitment
from carecontact.errors import ConfigError
from carecontact.runs.manifest import MANIFEST, Manifest, read_manifest, store_manifest

DIGITS = 64
"""Number of digits of a salt, in base 16: as many as its hash has."""


def make_salt(path: Path) -> str:
    """Write a new secret, which only its owner may read, and return its sha256, that of the file's bytes.

    Raises ConfigError for a file that exists already.
    """
    try:
        handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be made: {error.strerror}; name a new file") from None
    with os.fdopen(handle, "w") as stream:
        stream.write(secrets.token_hex(DIGITS // 2))
    return commitment(read_salt(path))


def read_salt(path: Path) -> str:
    """Return the secret in a file; a line's end after it does not count. Raises ConfigError for anything else."""
    try:
        salt = path.read_text(errors="replace").strip()
    except OSError as error:
        raise ConfigError(f"--salt-file {path}: cannot be read: {error.strerror}") from None
    if len(salt) != DIGITS or not set(salt) <= set("0123456789abcdef"):
        raise ConfigError(
            f"--salt-file {path}: expected {DIGITS} hexadecimal digits, as `carecontact salt make` writes them"
        )
    return salt


def with_salt(specs: Sequence[TrialSpec], salt: str) -> list[TrialSpec]:
    """Return the trials with a secret on which every draw depends; as they are where it is empty."""
    return list(specs) if not salt else [spec.model_copy(update={"salt": salt}) for spec in specs]


def reveal_salt(run: Path, salt: str) -> None:
    """Write the secret into a run's manifest, from where anyone may verify it.

    Raises ConfigError if the folder is not a run, if the run has no salt, or if the secret is not the run's.
    """
    manifest = committed(run)
    if commitment(salt) != manifest.salt_sha256:
        raise ConfigError(
            f"{run} was run with the salt whose sha256 is {manifest.salt_sha256}, and this one's is {commitment(salt)}"
        )
    store_manifest(manifest.model_copy(update={"salt": salt}), out=run)


def committed(run: Path) -> Manifest:
    """Return a run's manifest. Raises ConfigError if the folder is not a run, or the run has no salt."""
    manifest = read_manifest(run)
    if manifest is None:
        raise ConfigError(f"{run} is not a run: it holds no {MANIFEST}")
    if not manifest.salt_sha256:
        raise ConfigError(f"{run} was run on published seeds, without --salt-file: there is no salt to reveal")
    return manifest

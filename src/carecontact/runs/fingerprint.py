"""Whether a file or folder that a policy was given, such as a checkpoint, is still the same."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from itertools import islice
from pathlib import Path

WHOLE_BYTES = 1 << 26
"""A longer file is sampled: hashing a checkpoint of many gigabytes would take longer than some runs."""
SAMPLES, SAMPLE_BYTES = 64, 1 << 16
"""Blocks of a longer file, evenly spaced from its beginning to its end."""
MAX_FILES = 10_000
"""Largest number of files of a folder; one with more is taken for something other than weights and has no
fingerprint."""


def fingerprints(arguments: Mapping[str, str]) -> dict[str, str]:
    """Argument -> fingerprint, for every argument whose text is the path of a file or folder, from here."""
    found: dict[str, str] = {}
    for name, text in arguments.items():
        try:
            fingerprint = fingerprint_of(Path(text)) if text else None
        except (OSError, ValueError):
            continue  # unreadable, or no path at all: the policy will say so
        if fingerprint is not None:
            found[name] = fingerprint
    return found


def fingerprint_of(path: Path) -> str | None:
    """Return a sha256 over the names, sizes and contents of a file or of all files of a folder.

    A file longer than WHOLE_BYTES counts with SAMPLES blocks of its content, so that a change of a few bytes of it may
    be missed. None for what is neither file nor folder, and for a folder of more than MAX_FILES files.
    """
    if path.is_file():
        return hashlib.sha256(b"".join(_pieces(path))).hexdigest()
    if not path.is_dir():
        return None
    files = list(islice((file for file in path.rglob("*") if file.is_file()), MAX_FILES + 1))
    if len(files) > MAX_FILES:
        return None
    digest = hashlib.sha256()
    for file in sorted(files):
        digest.update(str(file.relative_to(path)).encode(errors="surrogateescape") + b"\0")
        digest.update(hashlib.sha256(b"".join(_pieces(file))).digest())
    return digest.hexdigest()


def _pieces(path: Path) -> Iterator[bytes]:
    size = path.stat().st_size
    yield size.to_bytes(8, "little")
    with path.open("rb") as file:
        if size <= WHOLE_BYTES:
            yield file.read()
            return
        for k in range(SAMPLES):
            file.seek(k * (size - SAMPLE_BYTES) // (SAMPLES - 1))
            yield file.read(SAMPLE_BYTES)

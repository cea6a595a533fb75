"""What computed and drew a trial: it decides the last bits of the numbers and the pictures, and no comparison."""

from __future__ import annotations

import platform
from typing import cast

from carecontact.recording.schema import Recording

ARITHMETIC = "wall/arithmetic"
"""Array of a recording with the text as UTF-8. It lies outside the canonical hash, because other libraries that round
alike make the same recording."""

RENDERER = "wall/renderer"
"""Array with vendor, renderer and version of OpenGL as UTF-8: two renderers draw slightly different pictures."""


def provenance_of(recording: Recording) -> dict[str, str]:
    """Return ``arithmetic`` and ``renderer``, as far as recorded, and the hashes of the compiled ``model`` and of the
    ``kernel``'s binary."""
    texts = {"arithmetic": ARITHMETIC, "renderer": RENDERER}
    found = {
        name: recording[path].tobytes().decode(errors="replace") for name, path in texts.items() if path in recording
    }
    return found | {
        name: recording.header.sha256[name] for name in ("model", "kernel") if name in recording.header.sha256
    }


def arithmetic() -> str:
    """Return numpy's library of linear algebra with the kernels that it chose, the processor family, and the C library,
    as in ``openblas 0.3.31 SkylakeX on x86_64 with glibc 2.36``.

    OpenBLAS chooses its kernels by what the processor can do (``OPENBLAS_CORETYPE`` overrides it). Each sums a product
    of matrices in another order, and contact amplifies the last bits of a model that was built with such products.
    Two machines with the same text make the same recordings.
    """
    # Here, because it looks through all libraries of the process, and few callers need it.
    from threadpoolctl import threadpool_info  # pyright: ignore[reportMissingTypeStubs]

    libraries, none = cast("list[dict[str, str]]", threadpool_info()), dict[str, str]()
    # scipy and OpenCV bring their own.
    row = min((row for row in libraries if row["user_api"] == "blas"), key=_is_foreign, default=none)
    algebra = " ".join(row[key] for key in ("internal_api", "version", "architecture") if row.get(key))
    library = " ".join(filter(None, platform.libc_ver())) or "an unknown C library"
    return f"{algebra or 'unknown linear algebra'} on {platform.machine()} with {library}"


def _is_foreign(row: dict[str, str]) -> bool:
    return "numpy" not in row["filepath"]

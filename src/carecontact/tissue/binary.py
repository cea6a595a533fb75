"""Says which binary belongs to the C sources in this folder on which platform, and whether the installed one is it.

This module imports nothing but Python's standard library, because the build reads it before anything is installed.
`python src/carecontact/tissue/binary.py` ends with status 1 and prints why, if the library of this machine is missing
or is not the right one.
"""

from __future__ import annotations

import hashlib
import platform
import re
import struct
import sys
from dataclasses import dataclass
from pathlib import Path

FOLDER = Path(__file__).parent
SOURCES = FOLDER / "c"
MUJOCO = "4.0.0"
"""The only version of MuJoCo that the binary fits: the plugin reads MuJoCo's structures in memory, whose layout changes
from version to version."""
ZIG = "0.16.0"
"""Version of the package `ziglang`. Its C compiler makes every binary, because others round some expressions
differently."""
ELF_HEADER = 64
"""Length of the header of an ELF file of 64 bits."""
FLAGS = (
    *"-std=c17 -O3 -ffp-contract=off -fno-math-errno -fvisibility=hidden -fPIC -g0".split(),
    *"-Wall -Wextra -Wshadow -Werror".split(),
)
"""Flags of the compiler. They forbid fused multiply-adds and the reordering of sums, so that a result does not depend
on the processor.
-fno-math-errno changes no number: it lets the processor's square root stand for the library's."""


@dataclass(frozen=True)
class Platform:
    triple: str
    """Zig's name of the target, with the oldest C library or system that the binary runs on."""
    cpu: str
    """Zig's name of the oldest processor that MuJoCo's own wheels run on."""
    tag: str
    """Platform tag of the wheel that contains the binary."""
    library: str
    """File name of the binary in this folder."""


LINUX, MACOS = "libcarecontact_kernel.so", "libcarecontact_kernel.dylib"
PLATFORMS = {
    "linux-x86_64": Platform("x86_64-linux-gnu.2.17", "x86_64", "manylinux_2_17_x86_64", LINUX),
    "linux-aarch64": Platform("aarch64-linux-gnu.2.17", "generic", "manylinux_2_17_aarch64", LINUX),
    "macos-arm64": Platform("aarch64-macos.11.0", "apple_m1", "macosx_11_0_arm64", MACOS),
}
"""The platforms for which MuJoCo 4.0.0 has wheels, except Windows: policies need the processes of POSIX."""


def platform_here() -> str:
    """Return the name of this machine's platform, whether or not PLATFORMS has it."""
    system = {"darwin": "macos"}.get(sys.platform, sys.platform)
    machine = platform.machine().lower()
    return f"{system}-{'x86_64' if machine == 'amd64' else machine}"


def library_file(name: str) -> Path:
    """Return the path of a platform's binary. Raises KeyError if PLATFORMS does not have the platform."""
    return FOLDER / PLATFORMS[name].library


def sources_sha256() -> str:
    """Return the sha256 (hex) of the C sources, the compiler's version and its flags, the same on every platform."""
    digest = hashlib.sha256("\0".join((ZIG, *FLAGS)).encode())
    for source in sorted(SOURCES.glob("*.[ch]")):
        digest.update(f"\0{source.name}\0".encode())
        digest.update(hashlib.sha256(source.read_bytes()).digest())
    return digest.hexdigest()


def mark(name: str) -> str:
    """Return the text that the binary of a platform must contain: its platform, the sha256 of its sources, and MuJoCo's
    version."""
    return f"carecontact kernel for {name}, sources {sources_sha256()}, MuJoCo {MUJOCO}"


def mark_in(file: Path) -> str | None:
    """Return the mark that a binary contains, without loading the binary, or None if it contains none.

    Raises FileNotFoundError if there is no such file.
    """
    found = re.search(rb"carecontact kernel for [\w-]+, sources [0-9a-f]{64}, MuJoCo [\w.]+", file.read_bytes())
    return found[0].decode() if found else None


def is_cut_off(file: Path) -> bool:
    """Return whether an ELF file of 64 bits ends before its table of sections does, which the linker writes last.

    Loading such a file can end the process without a message. Other files give False: macOS checks its own.
    """
    content = file.read_bytes()
    if content[:5] != b"\x7fELF\2":
        return False
    if len(content) < ELF_HEADER:
        return True
    table, size, count = (*struct.unpack_from("<Q", content, 0x28), *struct.unpack_from("<HH", content, 0x3A))
    return len(content) < table + size * count


def fault(name: str) -> str | None:
    """Return why a platform's binary cannot be used, as the end of a sentence about it, or None if it can."""
    if name not in PLATFORMS:
        return f"does not exist for the platform {name}; it exists for {', '.join(PLATFORMS)}"
    file = library_file(name)
    if not file.is_file():
        return f"is missing: {file}"
    if mark_in(file) != mark(name):
        return f"does not belong to the C sources beside it: {file}"
    if is_cut_off(file):
        return f"is cut off: {file}"
    return None


if __name__ == "__main__":
    if platform_here() in PLATFORMS and (problem := fault(platform_here())):
        sys.exit(f"the compiled tissue {problem}")

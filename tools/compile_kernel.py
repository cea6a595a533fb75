"""Compiles the C sources of the tissue (src/carecontact/tissue/c) with the package ziglang, for any platform.

The build of the package does this (hatch_build.py). It needs `ziglang` and MuJoCo's headers in the running Python.
"""

from __future__ import annotations

import importlib.util
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from importlib import metadata
from pathlib import Path
from types import ModuleType

ROOT = Path(__file__).resolve().parents[1]


def load_binary(root: Path) -> ModuleType:
    """`carecontact.tissue.binary` without the package, whose dependencies a build does not have."""
    spec = importlib.util.spec_from_file_location(
        "carecontact_kernel_binary", root / "src" / "carecontact" / "tissue" / "binary.py"
    )
    assert spec is not None
    assert spec.loader is not None
    module = sys.modules[spec.name] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


binary = load_binary(ROOT)


def compile_kernel(out: Path, platform: str, *, cache: Path) -> None:
    """Write the library of a platform; a process that has loaded an older one at the same place keeps it.

    Args:
        cache: where the compiler keeps what it needs for each platform; may be deleted at any time.
    """
    target = binary.PLATFORMS[platform]
    if (found := metadata.version("ziglang")) != binary.ZIG:
        raise SystemExit(f"the tissue must be compiled with ziglang {binary.ZIG}; this is {found}")
    headers = mujoco_headers()
    compiler = [sys.executable, "-m", "ziglang", "cc", "-target", target.triple, f"-mcpu={target.cpu}"]
    out.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=out.parent) as folder:
        if target.library.endswith(".so"):
            link = [str(stub(Path(folder), headers, compiler, cache=cache)), "-lm", "-Wl,-z,defs"]
        else:
            link = ["-Wl,-undefined,dynamic_lookup", f"-Wl,-install_name,@rpath/{out.name}"]
        made = Path(folder, out.name)
        run([*compiler, *arguments(headers, platform), "-s", *link, "-o", str(made)], cache=cache)
        made.replace(out)


def arguments(headers: Path, platform: str, flags: Sequence[str] = binary.FLAGS) -> list[str]:
    """All arguments of the C compiler but the platform, the MuJoCo to link and where to write."""
    sources = [str(source) for source in sorted(binary.SOURCES.glob("*.c"))]
    define = f'-DCARECONTACT_KERNEL_MARK="{binary.mark(platform)}"'
    no_path = f"-ffile-prefix-map={binary.SOURCES}=."  # __FILE__ would put the folder of the build into the binary
    return [*flags, "-shared", define, no_path, "-isystem", str(headers), *sources]


def mujoco_headers() -> Path:
    """Folder of the headers in MuJoCo's wheel, which must be of the version that the plugin is made for."""
    found = importlib.util.find_spec("mujoco")  # not imported: importing it takes a second and needs a display library
    if found is None or found.origin is None:
        raise SystemExit(f"MuJoCo's headers are missing; install mujoco-core=={binary.MUJOCO}")
    headers = Path(found.origin).parent / "include"
    text = (headers / "mujoco" / "mujoco.h").read_text()
    number = int(re.findall(r"#define mjVERSION_HEADER (\d+)", text)[0])
    version = f"{number // 10**6}.{number // 10**3 % 10**3}.{number % 10**3}"
    if version != binary.MUJOCO:
        raise SystemExit(f"the tissue must be compiled for MuJoCo {binary.MUJOCO}; {headers} is of {version}")
    return headers


def stub(folder: Path, headers: Path, compiler: Sequence[str], *, cache: Path) -> Path:
    """Make a library with the name of MuJoCo's and all its functions, empty. Who links it needs exactly that version
    when it is loaded, but no MuJoCo of the platform when it is built."""
    source, made = folder / "stub.c", folder / "libmujoco_stub.so"
    source.write_text("".join(f"void {name}(void) {{}}\n" for name in mujoco_functions(headers)))
    name = f"-Wl,-soname,libmujoco.so.{binary.MUJOCO}"
    run([*compiler, "-shared", "-fPIC", "-nostdlib", "-g0", "-w", name, str(source), "-o", str(made)], cache=cache)
    return made


def mujoco_functions(headers: Path) -> list[str]:
    """Names of all functions that MuJoCo's library has."""
    text = (headers / "mujoco" / "mujoco.h").read_text()
    return sorted(set(re.findall(r"^MJAPI (?!extern)[^;(]*?\b(mj\w+)\(", text, re.MULTILINE)))


def run(command: Sequence[str], *, cache: Path) -> None:
    """Raises SystemExit with the output of the compiler."""
    folders = {"ZIG_GLOBAL_CACHE_DIR": str(cache), "ZIG_LOCAL_CACHE_DIR": str(cache)}
    done = subprocess.run(command, env={**os.environ, **folders}, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"the tissue's C sources do not compile:\n{done.stderr}")


if __name__ == "__main__":
    here = binary.platform_here()
    compile_kernel(binary.library_file(here), here, cache=ROOT / "build" / "zig")

"""Checks of this machine: all of them for ``carecontact doctor``, and the quick ones before the first trial of a run,
so that one fault of the machine is one message and not a failure of every trial."""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import cache, partial
from importlib import metadata, resources
from pathlib import Path

from carecontact.errors import DependencyError, counted
from carecontact.system import CACHE_VARIABLE, cache_folder, installed_version

PYTHON = ((3, 11), (3, 15))
"""The lowest version that is supported, and the first above it that is not."""
PACKAGES = {
    "mujoco": "mujoco==4.0.0",
    "numpy": "'numpy>=2,<3'",
    "scipy": "scipy",
    "h5py": "h5py",
    "pydantic": "'pydantic>=2.9'",
    "pydantic-monty": "'pydantic-monty>=1.4,<2'",
    **{name: name for name in ("websockets", "msgpack", "jinja2", "pillow")},
    "ai-edge-litert": "'ai-edge-litert>=2.3,<3'",
}
"""Name of a distribution -> the requirement that pip installs for it."""
EXTRAS = {
    "figures": (("matplotlib",), "export paper, view --start and --notes, calibrate and verify"),
    "tables": (("pyarrow", "pandas"), "results.parquet, run.trials() and export lerobot"),
    "viz": (("av", "rerun-sdk", "matplotlib"), "view --video and the viewer"),
    "live": (("openai",), "language models"),
    "learn": (("gymnasium",), "environments for learning"),
    "fem": (("scikit-fem",), "verify physics --fem"),
    "cluster": (("ray",), "run --engine ray"),
    "grounded-sam": (("torch", "transformers"), "--segmenter grounded-sam"),
}
"""Extra of this package -> the distributions that it installs, and what needs it."""
MEMORY_PER_TRIAL_GIB = 1.0
"""Memory that a trial needs: 0.6 GiB (measured), and its policy's process comes on top."""
PROBE_LIMIT_S = 120.0

CONTEXT_PROBE = "from carecontact.sim.opengl import probe; probe()"
FRAME_PROBE = """
from carecontact.sim.opengl import make_context
make_context(64, 64).free()
import mujoco
model = mujoco.MjModel.from_xml_string(
    "<mujoco><worldbody><light pos='0 0 3'/><geom type='sphere' size='.3' rgba='1 0 0 1'/>"
    "<camera name='c' pos='0 -2 0' xyaxes='1 0 0 0 0 1'/></worldbody></mujoco>")
data = mujoco.MjData(model)
mujoco.mj_forward(model, data)
with mujoco.Renderer(model, 120, 160) as renderer:
    renderer.update_scene(data, "c")
    image = renderer.render()
assert image[60, 80, 0] > 30 + image[0, 0, 0], "the picture does not show the sphere that is in the scene"
"""
POSE_PROBE = "from carecontact.sensing.blazepose import BlazePose; BlazePose().warm_up()"
TISSUE_PROBE = "from carecontact.tissue.plugin import load_plugins as load; load()"


@dataclass(frozen=True)
class Finding:
    name: str
    fine: bool
    detail: str
    fix: str | None = None
    """The command that installs what is missing."""
    warning: bool = False
    """Whether trials can run, but lack something that they should have."""


def findings(*, quick: bool = False) -> Iterator[Finding]:
    """Run the checks, one at a time; ``quick``: only those of some 0.1 s whose failure would fail every trial."""
    checks = [check_python, check_temporary_folder, partial(check_opengl, frame=not quick)]
    if not quick:
        checks += [check_packages, check_extras, check_tissue, check_pose, check_assets]
        checks += [check_kept, check_isolation, check_machine]
    return (check() for check in checks)


@cache
def check_ready() -> None:
    """Check once in each process, before its first trial, that trials can run here."""
    from carecontact.sim.opengl import INSTALLING

    with suppress(BlockingIOError):
        for finding in findings(quick=True):
            if not finding.fine:
                fix = f"{INSTALLING}{finding.fix}" if finding.fix else ""
                raise DependencyError(f"this machine cannot run trials: {finding.name}: {finding.detail}{fix}")


def check_python() -> Finding:
    low, high = PYTHON
    version = ".".join(map(str, sys.version_info[:3]))
    fine = low <= sys.version_info[:2] < high
    return Finding("python", fine, version if fine else f"{version}; needs 3.11 to 3.14")


def check_packages() -> Finding:
    found = {package: installed_version(package) for package in PACKAGES}
    absent = [package for package, version in found.items() if version is None]
    if absent:
        fix = "; ".join(f"{sys.executable} -m pip install {PACKAGES[package]}" for package in absent)
        return Finding("packages", False, f"not installed: {', '.join(absent)}", fix)
    return Finding("packages", True, ", ".join(f"{name} {version}" for name, version in found.items()))


def check_extras() -> Finding:
    """List the optional parts that cannot be used. No trial needs any of them."""
    lacking = [name for name, (packages, _) in EXTRAS.items() if None in map(installed_version, packages)]
    if not lacking:
        return Finding("extras", True, "all installed")
    parts = ", ".join(f"{name} (for {EXTRAS[name][1]})" for name in lacking)
    command = f"pip install 'carecontact[{lacking[0]}]'"
    return Finding("extras", True, f"optional and not installed: {parts}; {command} adds the first")


def check_tissue() -> Finding:
    from carecontact.tissue import binary, binary_lookup

    if problem := binary_lookup.binary_problem():
        what, command = problem
        return Finding("tissue", False, f"the compiled tissue {what}", command)
    platform, sha256 = binary.platform_here(), binary_lookup.binary_sha256()[:12]
    fault = _probe(TISSUE_PROBE, environment={"MUJOCO_GL": "disable"})
    detail = f"compiled for MuJoCo {binary.MUJOCO} and {platform}, sha256 {sha256}; {fault or 'it loads'}"
    return Finding("tissue", fault is None, detail, binary_lookup.build_command(afresh=True) if fault else None)


def check_temporary_folder() -> Finding:
    """Make and lock a folder where every policy's process gets one."""
    from carecontact.serving.sandbox import private_folder

    try:
        folder = private_folder()
    except OSError as error:
        fault = f"no folder for a policy's process can be made and locked: {error}"
        return Finding("temporary", False, f"{fault}; correct this, or name another folder in the variable TMPDIR")
    folder.remove()
    return Finding("temporary", True, str(folder.path.parent))


def check_opengl(*, frame: bool = True) -> Finding:
    """Make a context as every trial does; with ``frame``, MuJoCo also renders a picture: 0.5 s more."""
    from carecontact.sim.opengl import INSTALLING, LIBRARIES, choose_backend

    problem = _probe(FRAME_PROBE if frame else CONTEXT_PROBE, environment={})
    if problem is not None:
        fault, _, fix = problem.removeprefix("carecontact.errors.DependencyError: ").partition(INSTALLING)
        return Finding("OpenGL", False, fault, fix or None)
    chosen = "by MUJOCO_GL" if os.environ.get("MUJOCO_GL", "").lower() in LIBRARIES else "by what is installed"
    drew = f"; MuJoCo {metadata.version('mujoco')} rendered a frame" if frame else ""
    return Finding("OpenGL", True, f"{choose_backend()}, chosen {chosen}{drew}")


def check_pose() -> Finding:
    problem = _probe(POSE_PROBE, environment={})
    if problem is None:
        return Finding("vision", True, "both networks of the pose model ran")
    pip = f"{sys.executable} -m pip install"
    fix = f"{pip} {PACKAGES['ai-edge-litert']}"
    return Finding("vision", False, f"the pose model does not run: {problem}", fix)


def check_assets() -> Finding:
    """Compare every baked file with the hash in its provenance file."""
    checked, wrong = [], []
    for note in sorted(Path(str(resources.files("carecontact"))).glob("assets/*/*.provenance.json")):
        stem = note.name.removesuffix(".provenance.json")
        baked = next(
            (p for kind in ("npz", "png", "tflite") if (p := note.with_name(f"{stem}.{kind}")).is_file()), None
        )
        name = f"{note.parent.name}/{baked.name if baked else stem}"
        if baked and hashlib.sha256(baked.read_bytes()).hexdigest() == json.loads(note.read_bytes())["sha256"]:
            checked.append(name)
        else:
            wrong.append(f"{name} is missing or does not match the sha256 in its provenance file")
    if wrong or not checked:
        pip = f"{sys.executable} -m pip install --force-reinstall --no-deps CARECONTACT.whl"
        fix = f"git checkout -- src/carecontact/assets (in a clone), or {pip}"
        return Finding("assets", False, "; ".join(wrong) or "no asset is installed", fix)
    return Finding("assets", True, ", ".join(sorted(checked)))


def check_kept() -> Finding:
    """Show where settled persons are kept between trials; a trial without them takes longer and is the same."""
    folder = cache_folder()
    if folder is None:
        why = "as CARECONTACT_CACHE is empty" if CACHE_VARIABLE in os.environ else "as this user has no home folder"
    else:
        try:
            folder.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=folder):
                return Finding("kept", True, str(folder))
        except OSError as error:
            why = f"as {folder} cannot be written to ({error.strerror})"
    remedy = f"name a folder in the variable {CACHE_VARIABLE} to make them faster"
    return Finding("kept", True, f"nothing is kept between trials, {why}; {remedy}", warning=True)


def check_isolation() -> Finding:
    """Say how far a policy can be isolated, and whether it runs as root."""
    from carecontact.serving.fence import available

    lines = [available()]
    if not lines[0].startswith("full"):
        lines.append("run policies that you do not trust on another host (docs/trust.md)")
    if hasattr(os, "geteuid") and os.geteuid() == 0:
        lines.append("you are root, and so is every policy: run policies that you do not trust as an ordinary user")
    return Finding("isolation", True, "; ".join(lines), warning=len(lines) > 1)


def check_machine() -> Finding:
    """Say how many trials fit on this machine, and what rounds their numbers."""
    import numpy  # noqa: F401  # Its linear algebra is that of the trials.

    from carecontact.recording.provenance import arithmetic
    from carecontact.running.workers import available_cores

    cores = available_cores()
    detail = counted(cores, "core")
    if hasattr(os, "sysconf") and "SC_PHYS_PAGES" in os.sysconf_names:
        memory = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") / 2**30
        detail += f", {memory:.0f} GiB of memory"
        if memory < MEMORY_PER_TRIAL_GIB * cores:
            detail += f"; use --jobs {max(1, int(memory / MEMORY_PER_TRIAL_GIB))}"
    return Finding("machine", True, f"{detail}; numbers are rounded by {arithmetic()}")


def _probe(code: str, *, environment: dict[str, str]) -> str | None:
    """Run code in a process, which a broken library may crash. Return None, or the last line of its output."""
    try:
        done = subprocess.run(
            [sys.executable, "-P", "-c", code],
            env={**os.environ, **environment},
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            errors="replace",
            timeout=PROBE_LIMIT_S,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return f"it did not end within {PROBE_LIMIT_S:g} s"
    if done.returncode == 0:
        return None
    return (done.stderr.strip().splitlines() or [f"its process ended with status {done.returncode}"])[-1]

#!/bin/sh
# Makes .venv from uv.lock on a machine that has nothing but Python 3.11 to 3.14. Quick when nothing changed.
set -eu
cd "$(dirname "$0")/.."

UV_VERSION=0.13.8
VENV=.venv
UV_VENV=.venv-uv
STAMP=$VENV/.bootstrap-stamp

say() { printf 'bootstrap: %s\n' "$*" >&2; }
fail() { say "$@"; exit 1; }
is_root() { [ "$(id -u)" = 0 ]; }

# Installs Debian packages as root; another user gets the line to type.
need_packages() {
    command -v apt-get >/dev/null 2>&1 || fail "install the equivalent of these Debian packages: $*"
    is_root || fail "run this line, then the same command again: sudo apt-get install -y $*"
    say "installing $*"
    { apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "$@"; } \
        </dev/null >/dev/null || fail "apt-get could not install $*"
}

find_python() {
    for candidate in python3.11 python3.12 python3.13 python3.14 python3; do
        if "$candidate" -c 'import sys; sys.exit(not (3, 11) <= sys.version_info[:2] < (3, 15))' 2>/dev/null; then
            "$candidate" -c 'import sys; print(sys.executable)'
            return
        fi
    done
}

loads() { "$PYTHON" -c 'import ctypes, sys; [ctypes.CDLL(name) for name in sys.argv[1:]]' "$@" 2>/dev/null; }

missing=
PYTHON=$(find_python)
if [ -z "$PYTHON" ]; then
    say "no Python 3.11, 3.12, 3.13 or 3.14 found"
    need_packages python3 python3-venv
    PYTHON=$(find_python)
    [ -n "$PYTHON" ] || fail "this system's python3 is none of 3.11 to 3.14; install one of these"
fi
if ! [ -x "$UV_VENV/bin/python" ] && ! "$PYTHON" -c 'import ensurepip, venv' 2>/dev/null; then
    say "Python's venv module is missing"
    missing="python$("$PYTHON" -c 'import sys; print("%d.%d" % sys.version_info[:2])')-venv"
fi
# Headless rendering: EGL unless only the other software renderer is there or MUJOCO_GL=osmesa asks for it.
if ! loads libOSMesa.so.8; then
    if [ "${MUJOCO_GL:-}" = osmesa ]; then
        say "libOSMesa is missing"
        missing="$missing libosmesa6"
    elif ! loads libEGL.so.1 libGL.so.1; then
        say "libEGL or libGL is missing"
        missing="$missing libegl1 libgl1 libgl1-mesa-dri"
    fi
fi
# shellcheck disable=SC2086 # a list of packages
[ -z "$missing" ] || need_packages $missing

wanted="uv $UV_VERSION $("$PYTHON" -c '
import hashlib, os, sys
names = ("uv.lock", "pyproject.toml")
print(sys.version_info[:3], os.getcwd(), *(hashlib.sha256(open(name, "rb").read()).hexdigest() for name in names))')"
complete() { [ -x "$VENV/bin/python" ] && [ "$(cat "$STAMP" 2>/dev/null)" = "$wanted" ]; }
tissue_fault() { "$PYTHON" src/carecontact/tissue/binary.py 2>&1; }
if complete && tissue_fault >/dev/null; then
    exit 0
fi

if ! "$UV_VENV/bin/uv" --version 2>/dev/null | grep -q "^uv $UV_VERSION\b"; then
    say "installing uv $UV_VERSION into $UV_VENV"
    rm -rf "$UV_VENV"
    "$PYTHON" -m venv "$UV_VENV"
    "$UV_VENV/bin/python" -m pip install --quiet --disable-pip-version-check "uv==$UV_VERSION"
fi

# --inexact: packages that the user installed beside carecontact stay.
# --reinstall-package: uv does not know that a compiled library in the source tree was deleted or edited.
# UV_PROJECT_ENVIRONMENT and VIRTUAL_ENV of the caller must not send the packages elsewhere.
sync() {
    env -u VIRTUAL_ENV UV_PROJECT_ENVIRONMENT="$VENV" UV_PYTHON_DOWNLOADS=never \
        "$UV_VENV/bin/uv" sync --frozen --inexact --quiet --compile-bytecode --reinstall-package carecontact \
        --python "$PYTHON" "$@"
}
if complete; then
    say "$(tissue_fault); compiling it"
    # Needs no network where an earlier build left the compiler in uv's cache.
    sync --offline 2>/dev/null || sync
else
    say "installing the locked packages into $VENV (about 900 MB) and compiling the tissue"
    sync
fi
printf '%s\n' "$wanted" >"$STAMP"
say "ready"

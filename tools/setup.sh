#!/usr/bin/env bash
# Sets up everything that the project needs on Debian or Ubuntu: the system libraries that wheels
# miss, a virtual environment .venv, PyTorch and the project itself in editable mode.
# Safe to run again; does nothing when nothing has changed since the last time.
#
#   tools/setup.sh        what the demo needs
#   tools/setup.sh dev    and what tests and documentation need
set -euo pipefail
cd "$(dirname "$0")/.."

TORCH="torch==2.13.0"
venv_python=.venv/bin/python
extra="${1:+[$1]}"
stamp=".venv/.feasigrasp-setup$extra"

# What the stamp remembers: the recipe, the requirements, and where the checkout lies.
key="$(cat pyproject.toml tools/setup.sh tools/constraints.txt | sha256sum | cut -d ' ' -f 1) $PWD"
is_done() { [[ -f $1 && "$(cat "$1")" == "$key" && -x $venv_python ]]; }
# An environment for tests has all that the demo needs.
if is_done "$stamp" || is_done ".venv/.feasigrasp-setup[dev]"; then
    exit 0
fi

say() { printf 'setup: %s\n' "$*"; }
fail() { printf 'setup: %s\n' "$*" >&2; exit 1; }

# Installs Debian packages as root; otherwise prints the command and stops.
need_packages() {
    local command="apt-get install -y --no-install-recommends $*"
    command -v apt-get > /dev/null ||
        fail "please install what Debian calls: $*, then run this again"
    if [[ $(id -u) -ne 0 ]]; then
        fail "please run: sudo $command   and then this again"
    fi
    say "$command"
    apt-get update -qq || say "apt-get update failed; trying with the package lists at hand"
    DEBIAN_FRONTEND=noninteractive $command > /dev/null || fail "failed: $command"
}

# 1. A Python that is new enough and can make virtual environments.
python=""
for candidate in python3 python3.13 python3.12 python3.11; do
    if "$candidate" -c 'import sys; sys.exit(not (3, 11) <= sys.version_info < (3, 14))' 2> /dev/null; then
        python=$candidate
        break
    fi
done
[[ -n $python ]] || fail "Python 3.11, 3.12 or 3.13 is needed, but \
$(python3 --version 2> /dev/null || echo 'no python3') was found; install python3.11 (or newer)"

# 2. What Debian packages apart: venv, and shared libraries that Drake and Open3D load.
missing=$("$python" - << 'EOF'
import ctypes
import importlib.util
import sys

LIBRARIES = {
    "libEGL.so.1": "libegl1",
    "libGL.so.1": "libgl1",
    "libglib-2.0.so.0": "libglib2.0-0",
    "libusb-1.0.so.0": "libusb-1.0-0",
    "libX11.so.6": "libx11-6",
}
if importlib.util.find_spec("ensurepip") is None:
    print("python{}.{}-venv".format(*sys.version_info))
for library, package in LIBRARIES.items():
    try:
        ctypes.CDLL(library)
    except OSError:
        print(package)
EOF
)
# shellcheck disable=SC2086  # one word per package
[[ -z $missing ]] || need_packages $missing

# 3. The virtual environment. A broken one (Python gone) is made anew.
if ! $venv_python -c '' 2> /dev/null; then
    say "creating .venv with $("$python" --version)"
    "$python" -m venv --clear .venv
fi
say "installing $TORCH and the project into .venv (a few minutes the first time)"
$venv_python -m pip install --quiet --disable-pip-version-check -c tools/constraints.txt "$TORCH"
$venv_python -m pip install --quiet --disable-pip-version-check -c tools/constraints.txt \
    --editable ".$extra" "$TORCH"

echo "$key" > "$stamp"
say "done"

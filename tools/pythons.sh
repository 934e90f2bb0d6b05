#!/usr/bin/env bash
# Prints the Python interpreters that can be had here (path, pyenv, uv): one line for each minor
# version from 3.11 on, newest first.
set -euo pipefail

shopt -s nullglob
for minor in 14 13 12 11; do
    for python in "$(command -v "python3.$minor" || true)" \
        "${PYENV_ROOT:-$HOME/.pyenv}/versions/3.$minor".*/bin/python \
        "${UV_PYTHON_INSTALL_DIR:-$HOME/.local/share/uv/python}/cpython-3.$minor".*/bin/python; do
        # A pyenv shim is on the path for versions that are not chosen, and then fails.
        if "$python" -c 'import ensurepip' 2> /dev/null; then
            printf '%s\n' "$python"
            break
        fi
    done
done

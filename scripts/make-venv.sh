#!/usr/bin/env bash
# Make a virtual environment with pip in it: make-venv.sh FOLDER
# PYTHON names the interpreter to use; the default is python3.
set -euo pipefail

venv=$1
python=${PYTHON:-python3}

fail() {
    echo "make-venv: $1" >&2
    exit 1
}

# The Debian package of venv for this interpreter, installed where that needs no password.
install_venv() {
    local package sudo=()
    package=$("$python" -c 'import sys; print("python%d.%d-venv" % sys.version_info[:2])')
    [ "$(id -u)" = 0 ] || sudo=(sudo -n)
    echo "Installing $package ..."
    { "${sudo[@]}" apt-get update -qq && "${sudo[@]}" apt-get install -y -qq "$package"; } \
        >/dev/null 2>&1 ||
        fail "$python cannot make virtual environments; run: sudo apt-get install $package"
}

command -v "$python" >/dev/null ||
    fail "$python was not found; run: sudo apt-get install python3 python3-venv"
"$python" -c 'import sys; sys.exit(sys.version_info < (3, 11))' ||
    fail "prtnet needs Python 3.11 or newer and $python is $("$python" -V); name another: make PYTHON=python3.12"
"$python" -c 'import ensurepip' 2>/dev/null || install_venv
"$python" -m venv "$venv"

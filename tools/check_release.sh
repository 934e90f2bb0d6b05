#!/usr/bin/env bash
# Tries wheel and sdist in dist/ as a stranger would: the wheel with every Python that can be had
# here, each in an empty environment and from another folder, and whether version, changelog and
# citation agree.
set -euo pipefail
cd "$(dirname "$0")/.."
root=$PWD

fail() { printf 'release: %s\n' "$*" >&2; exit 1; }

version=$(sed -n 's/^__version__ = "\(.*\)"$/\1/p' feasigrasp/__init__.py)
grep -q "^## \[$version\] - 20" CHANGELOG.md || fail "CHANGELOG.md has no dated entry for $version"
grep -q "^version: $version$" CITATION.cff || fail "CITATION.cff is not of version $version"
PYTHONPATH=. .venv/bin/python tools/figures.py check ||
    fail "figures of README or docs are of other code; make results"

folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
torch=$(sed -n 's/^TORCH="\(.*\)"$/\1/p' tools/setup.sh)

# Installs a file with an interpreter and runs README, with nothing of the checkout to be found.
try_file() {
    rm -rf "$folder/venv" "$folder/elsewhere"
    "$1" -m venv "$folder/venv"
    "$folder/venv/bin/pip" install --quiet --disable-pip-version-check "$torch" "$2"
    mkdir "$folder/elsewhere"
    run_readme="env -i HOME=$folder PATH=$folder/venv/bin:/usr/bin:/bin python $root/tools/run_readme.py"
    (cd "$folder/elsewhere" && $run_readme) || fail "README fails with $(basename "$2") and $("$1" --version)"
    printf 'release: %s runs in an empty environment with %s\n' "$(basename "$2")" "$("$1" --version)"
}

wheel=$root/dist/feasigrasp-$version-py3-none-any.whl sdist=$root/dist/feasigrasp-$version.tar.gz
[[ -f $wheel && -f $sdist ]] || fail "$wheel or $sdist is missing; run make wheel"
for python in $(tools/pythons.sh); do
    try_file "$python" "$wheel"
done
try_file "$python" "$sdist"

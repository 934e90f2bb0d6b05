#!/usr/bin/env bash
# Tries wheel and sdist in dist/ as a stranger would: each in an empty environment and from another
# folder, and whether version, changelog and citation agree.
set -euo pipefail
cd "$(dirname "$0")/.."
root=$PWD

fail() { printf 'release: %s\n' "$*" >&2; exit 1; }

version=$(sed -n 's/^__version__ = "\(.*\)"$/\1/p' feasigrasp/__init__.py)
grep -q "^## \[$version\] - 20" CHANGELOG.md || fail "CHANGELOG.md has no dated entry for $version"
grep -q "^version: $version$" CITATION.cff || fail "CITATION.cff is not of version $version"

folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
torch=$(sed -n 's/^TORCH="\(.*\)"$/\1/p' tools/setup.sh)
for file in "$root/dist/feasigrasp-$version-py3-none-any.whl" "$root/dist/feasigrasp-$version.tar.gz"; do
    [[ -f $file ]] || fail "$file is missing; run make wheel"
    rm -rf "$folder/venv" "$folder/elsewhere"
    python3 -m venv "$folder/venv"
    "$folder/venv/bin/pip" install --quiet --disable-pip-version-check "$torch" "$file"
    mkdir "$folder/elsewhere"
    (
        cd "$folder/elsewhere"
        # Nothing of the checkout may be found.
        env -i HOME="$folder" PATH="$folder/venv/bin:/usr/bin:/bin" \
            python "$root/tools/run_readme.py" || fail "README fails with $(basename "$file")"
    )
    printf 'release: %s runs in an empty environment\n' "$(basename "$file")"
done

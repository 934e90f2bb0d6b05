#!/usr/bin/env bash
# Tries one run with the newest releases of Python and Drake that can be had here, in an environment
# of its own, out/newest, without torch and Open3D. Fails if the run does; says so where there is no
# newer Python than that of .venv.
set -euo pipefail
cd "$(dirname "$0")/.."

say() { printf 'newest: %s\n' "$*"; }

minor='import sys; print(sys.version_info.minor)'
own=$(.venv/bin/python -c "$minor")
newest=$(tools/pythons.sh)
newest=${newest%%$'\n'*}
if [[ -z $newest || $("$newest" -c "$minor") -le $own ]]; then
    say "skipped: no newer Python than 3.$own here (pyenv, uv or python3.N on the path)"
    exit 0
fi

rm -rf out/newest
"$newest" -m venv out/newest
python=$PWD/out/newest/bin/python
# What the project requires, but for the two packages that runs do not need.
"$python" - > out/newest/requirements.txt << 'PY'
import tomllib

with open("pyproject.toml", "rb") as file:
    required = tomllib.load(file)["project"]["dependencies"]
print("\n".join(entry for entry in required if not entry.startswith(("torch", "open3d"))))
PY
"$python" -m pip install --quiet --disable-pip-version-check -r out/newest/requirements.txt
"$python" -m pip install --quiet --disable-pip-version-check --no-deps .
say "$("$python" --version), Drake $("$python" -m pip show drake | sed -n 's/^Version: //p')"
cd out/newest
# Every module, but for those that need what is left out here.
"$python" - << 'PY'
import pkgutil
from importlib import import_module

import feasigrasp
import feasigrasp_lab

for package in (feasigrasp, feasigrasp_lab):
    for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
        try:
            import_module(module.name)
        except ModuleNotFoundError as error:
            if str(error.name).partition(".")[0].startswith("feasigrasp"):
                raise
PY
env -u PYTHONPATH OMP_NUM_THREADS=1 PYTHONWARNINGS=error::DeprecationWarning:pydrake \
    timeout 240 "$python" -m feasigrasp.cli run ReachLinear --seed 1 --results results.json > run.log ||
    { cat run.log >&2; say "the run fails" >&2; exit 1; }
grep -q '"grasp_held": true' results.json || { cat run.log >&2; say "nothing was held" >&2; exit 1; }
say "ReachLinear, seed 1: held"

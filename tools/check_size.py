"""Checks the sizes of packages, documentation and data against pyproject.toml.

Run by ``make lint``. A size is a ceiling: whoever adds to one part takes away elsewhere in it.
"""

from __future__ import annotations

import subprocess
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def sizes(files: list[Path]) -> dict[str, int]:
    """Lines and files of both packages, bytes of the pages and of all JSON, lines of README."""
    found = {}
    for package in ("feasigrasp", "feasigrasp_lab"):
        sources = [f for f in files if f.suffix == ".py" and f.parts[0] == package]
        found[f"{package}.files"] = len(sources)
        found[f"{package}.lines"] = sum(len((ROOT / f).read_text().splitlines()) for f in sources)
    pages = [f for f in files if f.suffix == ".md" and f.parts[0] == "docs"]
    found["docs.pages"] = len(pages)
    found["docs.bytes"] = sum((ROOT / f).stat().st_size for f in pages)
    found["readme.lines"] = len((ROOT / "README.md").read_text().splitlines())
    found["json.bytes"] = sum((ROOT / f).stat().st_size for f in files if f.suffix == ".json")
    return found


def main() -> int:
    """Prints what is too large; returns 1 then."""
    listed = subprocess.run(
        ["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True
    )
    files = [Path(line) for line in listed.stdout.splitlines() if (ROOT / line).is_file()]
    ceilings = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["feasigrasp"]["size"]
    found = sizes(files)
    for name, size in found.items():
        print(f"{name:22s} {size:9,d} of {ceilings[name]:9,d}")
    large = [name for name, size in found.items() if size > ceilings[name]]
    if large:
        print(f"too large: {', '.join(large)}; take something away, see docs/developing.md")
    return 1 if large else 0


if __name__ == "__main__":
    sys.exit(main())

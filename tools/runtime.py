"""Files that a run depends on and that changed since a revision, docstrings and comments aside."""

from __future__ import annotations

import ast
import io
import subprocess
import tarfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
#: What a run reads. Tests, tools, documents and the lab, which measures, are not part of it.
FOLDERS = ("feasigrasp", "models", "diagrams/dynamic.scenarios.yaml")


def changed_since(revision: str, root: Path = ROOT) -> list[str]:
    """Paths whose content differs between a revision and HEAD by more than words about it.

    Raises:
        subprocess.CalledProcessError: The revision is not in the repository.
    """
    command = ["git", "diff", "--name-only", "--no-renames", revision, "HEAD", "--", *FOLDERS]
    output = subprocess.run(command, cwd=root, capture_output=True, text=True, check=True).stdout
    paths = output.split("\n")[:-1]
    then, now = (_contents(each, paths, root) for each in (revision, "HEAD"))
    return [path for path in paths if _meaning(path, then) != _meaning(path, now)]


def _contents(revision: str, paths: list[str], root: Path) -> dict[str, bytes]:
    """Contents of those of the paths that a revision has."""
    command = ["git", "archive", revision, *FOLDERS]
    archive = subprocess.run(command, cwd=root, capture_output=True, check=True).stdout
    with tarfile.open(fileobj=io.BytesIO(archive)) as tar:
        members = {member.name: member for member in tar if member.isfile()}
        files = {path: tar.extractfile(members[path]) for path in paths if path in members}
        return {path: file.read() for path, file in files.items() if file is not None}


def _meaning(path: str, contents: dict[str, bytes]) -> bytes | str | None:
    """A file's content, of Python its syntax tree without docstrings; None of pages and stubs."""
    content = contents.get(path)
    if path.endswith((".md", ".pyi")):
        return None
    return content if content is None or not path.endswith(".py") else _code(content)


def _code(source: bytes) -> str:
    tree = ast.parse(source)
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        if isinstance(body, list):
            node.body = [each for each in body if not _is_text(each)]  # type: ignore[attr-defined]
    return ast.dump(tree)


def _is_text(node: ast.AST) -> bool:
    """Whether a statement is a string alone."""
    value = node.value if isinstance(node, ast.Expr) else None
    return isinstance(value, ast.Constant) and isinstance(value.value, str)

"""What a result says of where it comes from."""

import subprocess

from feasigrasp.runs.results.provenance import git_revision


def test_the_revision_is_that_of_the_checkout(repository):
    command = ["git", "-C", str(repository), "rev-parse", "--short=12", "HEAD"]
    head = subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
    assert (git_revision() or "").removesuffix("-dirty") == head

"""A page as a browser without a window leaves it."""

import html
import json
import re
import subprocess

import pytest

from feasigrasp.runs import replay


def visit(url, folder, seconds=10.0):
    """What a page has written into its title as JSON, and its text, after some of its own time."""
    program = replay.browser()
    if program is None:
        pytest.skip("no browser: install chromium to run this test")
    flags = ("--headless", "--no-sandbox", "--no-first-run", "--disable-background-networking")
    flags += ("--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")
    flags += (f"--virtual-time-budget={1e3 * seconds:.0f}", f"--user-data-dir={folder}/profile")
    done = subprocess.run(
        [program, *flags, "--window-size=600,400", "--dump-dom", url],
        capture_output=True,
        text=True,
        timeout=120,
    )
    title = re.search(r"<title>(.*?)</title>", done.stdout)
    try:
        return json.loads(html.unescape(title[1])) if title else None, done.stdout
    except ValueError:
        return None, done.stdout

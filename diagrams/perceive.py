"""Perception only, from a real cloud: ``feasigrasp perceive`` by another name.

For example::

    python diagrams/perceive.py --cloud mug.ply --picture out/mug.png --html out/mug.html
"""

import sys

from feasigrasp.cli import main

if __name__ == "__main__":
    sys.exit(main(["perceive", *sys.argv[1:]]))

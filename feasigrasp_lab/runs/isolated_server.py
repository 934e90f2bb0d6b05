"""Fork server of `feasigrasp_lab.runs.isolated`: common imports, done once.

Importing this module loads all that a run needs and builds a diagram, so that compiled code is in
memory. It is for the server process that they are forked from, and for nothing else.
"""

import gc
import os

from feasigrasp.one_thread import THREAD_VARIABLES

# Before they are loaded: libraries, and Mesa (LP_), would start threads, which forking leaves out.
os.environ.update(dict.fromkeys((*THREAD_VARIABLES, "NUMBA_NUM_THREADS"), "1"), LP_NUM_THREADS="0")

from feasigrasp.resources import diagram_path  # noqa: E402
from feasigrasp.runs.results.provenance import git_revision  # noqa: E402
from feasigrasp.runs.run import run  # noqa: E402
from feasigrasp.scenario.files import load_scenario  # noqa: E402

git_revision()  # remembered: that of the code which has just been loaded
file = diagram_path("dynamic.scenarios.yaml")
run(load_scenario(file, "ReachLinearMocap", "{simulation_duration: 0.1}"))
# What is left of that run goes, with its renderer if Drake lets it (1.58 does not): a forked
# process would wait for threads of it at its first image. (Tracebacks of compiling keep it alive.)
gc.unfreeze()
gc.collect()
gc.freeze()  # the processes share what is never touched

"""The commands that this package adds to ``feasigrasp``: evaluate, bench, fit, train, report."""

from pathlib import Path

from feasigrasp.cli import Commands, commands_in

_PACKAGE = Path(__file__).parent
#: By group its purpose, and the modules of its commands.
_GROUPS = {
    "evaluate": ("measure how well grasping works", "studies/**/*.py"),
    "bench": ("measure computing times", "bench/*.py"),
    "fit": ("fit models to an arm and to grasps", "training/fit_*.py"),
    "train": ("train the networks of the package", "training/train_*.py"),
}
_REPORT = ("feasigrasp_lab.report.markdown_report", "write a folder of results as Markdown")


def commands() -> Commands:
    """All of them."""
    groups = {
        name: (purpose, commands_in(_PACKAGE, pattern))
        for name, (purpose, pattern) in _GROUPS.items()
    }
    return Commands(groups, {"report": _REPORT})

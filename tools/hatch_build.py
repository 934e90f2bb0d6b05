"""Build hook: the wheel carries models/ and diagrams/ inside the package.

An editable install does not get copies: there, the files of the checkout are used.
"""

from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

INSTALLED_AS = {"models": "feasigrasp/_models", "diagrams": "feasigrasp/_diagrams"}


class DataFilesHook(BuildHookInterface):
    """Adds the data folders to standard wheels."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Called by hatchling before a build; `version` is "standard" or "editable"."""
        if version == "standard":
            build_data["force_include"].update(INSTALLED_AS)

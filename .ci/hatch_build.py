"""Writes into wheel and source distribution which commit they are built from; in a checkout, git is asked."""

import runpy
from pathlib import Path
from tempfile import TemporaryDirectory

from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class Origin(BuildHookInterface):
    """Adds ``modaltouch/build.txt``: version and commit, as `modaltouch.system.provenance` reads them."""

    def initialize(self, version, build_data):
        """Add the file, but to what is built from a source distribution, which brings its own."""
        package = Path(self.root, "src", "modaltouch")
        self.folder = TemporaryDirectory()
        if version == "editable" or (package / "build.txt").exists():
            return
        commit = runpy.run_path(str(package / "system" / "provenance.py"))["commit"]()
        file = Path(self.folder.name, "build.txt")
        file.write_text(f"{self.metadata.version} {commit}\n", encoding="ascii")
        place = "modaltouch" if self.target_name == "wheel" else "src/modaltouch"
        build_data["force_include"][str(file)] = f"{place}/build.txt"

    def finalize(self, version, build_data, artifact_path):
        """Remove what was added only for the build."""
        self.folder.cleanup()

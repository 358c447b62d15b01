"""The one thing that pyproject.toml cannot say: a package without the operator's console is not built."""

from pathlib import Path

from setuptools import setup
from setuptools.command.build_py import build_py

CONSOLE = Path("service/console/built/index.html")


class BuildWhole(build_py):
    """An editable install comes before the console, which is built with what it installs; a wheel after it."""

    def run(self) -> None:
        if not self.editable_mode and not CONSOLE.is_file():
            raise SystemExit(f"there is no {CONSOLE}: `make wheel` builds the console first")
        super().run()


setup(cmdclass={"build_py": BuildWhole})

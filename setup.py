"""Refuse to build a wheel without the operator's console and the manual, which pyproject.toml cannot express."""

from pathlib import Path

from setuptools import setup
from setuptools.command.build_py import build_py

BUILT = (Path("service/console/built/index.html"), Path("service/manual/index.html"))


class BuildWhole(build_py):
    """A build that checks for both. An editable install does not: it provides the tools that build them."""

    def run(self) -> None:
        """Build the package.

        Raises:
            SystemExit: The console or the manual is not built.
        """
        missing = [str(path) for path in BUILT if not path.is_file()]
        if missing and not self.editable_mode:
            raise SystemExit(f"there is no {' and no '.join(missing)}: run `make wheel`, which builds them first")
        super().run()


setup(cmdclass={"build_py": BuildWhole})

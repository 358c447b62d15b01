"""The citation file is valid and names this release; the licence file is the complete Apache License 2.0."""

import hashlib
import subprocess
import sys
import tomllib

import yaml

from tests.docs.pages import ROOT

CITATION = ROOT / "CITATION.cff"
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
APACHE_2_SHA256 = "cfc7749b96f63bd31c3c42b5c471bf756814053e847c10f3eb003417bc523d30"
"""Hash of the text that the Apache Software Foundation publishes, with its appendix."""


def test_the_citation_file_is_valid() -> None:
    # The schema is part of check-jsonschema, so nothing is downloaded.
    command = [sys.executable, "-m", "check_jsonschema", "--builtin-schema", "vendor.citation-file-format"]
    done = subprocess.run([*command, str(CITATION)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def test_the_citation_file_names_this_release() -> None:
    citation = yaml.safe_load(CITATION.read_text())
    assert citation["version"] == PROJECT["version"]
    assert citation["license"] == PROJECT["license"]
    (paper,) = citation["references"]
    assert paper["title"].startswith("String Shape Recognition Using Enhanced Matching Method")
    assert [author["family-names"] for author in paper["authors"]] == ["Shirakawa", "Matsuno", "Yanou", "Minami"]


def test_the_licence_is_complete() -> None:
    assert PROJECT["license-files"] == ["LICENSE"]
    assert hashlib.sha256((ROOT / "LICENSE").read_bytes()).hexdigest() == APACHE_2_SHA256

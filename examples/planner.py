"""Scan, decide alone whether to grasp, to scan again or to ask a person, and print the grasp.

Run: python examples/planner.py [URL]. The service's arm moves. A token comes from POINTCHAIN_TOKEN, if set.
"""

import os
import sys

from pointchain_client import Client, ClientError, Grasp, Model

MORE_DATA_HELPS = {
    "connection-uncertain", "crossing-undecided", "end-unobserved", "possible-string", "scene-changed", "sharp-bend",
    "upper-strand-unseen",
}  # fmt: skip


def decide(model: Model, may_rescan: bool) -> Grasp | str:
    """Return a grasp to carry out, or what to do instead: `done`, `rescan` or `ask`."""
    if model.quality.verdict == "accept" and not model.chains:
        return "done"
    for grasp in model.grasps:
        if model.trusted(grasp.chain):
            return grasp
    more_data_helps = {finding.code for finding in model.quality.doubts} <= MORE_DATA_HELPS
    return "rescan" if may_rescan and model.quality.doubts and more_data_helps else "ask"


def main(url: str) -> int:
    """Return 0 when a grasp was printed or no string is there, 1 when a person must decide."""
    with Client(url, token=os.environ.get("POINTCHAIN_TOKEN")) as cell:
        model = cell.model(cell.scan(string_radius_m=0.0042))
        decision = decide(model, may_rescan=True)
        if decision == "rescan":
            model = cell.model(cell.scan(string_radius_m=0.0042))
            decision = decide(model, may_rescan=False)
        if isinstance(decision, Grasp):
            cell.release()  # returns when the arm is home: from here on this program may move it
            print(f"chain {decision.chain} at {decision.s_m:.3f} m, open to {decision.opening_m:.4f} m, T_base_grasp:")
            print(decision.T_base_grasp)
            return 0
    print(f"{decision}:", *(finding.message for finding in model.quality.findings), sep="\n  ", file=sys.stderr)
    return 0 if decision == "done" else 1


if __name__ == "__main__":
    try:
        sys.exit(main(sys.argv[1] if len(sys.argv) > 1 else "http://127.0.0.1:8000"))
    except ClientError as error:
        sys.exit(f"planner: {error}")

"""Scan, decide alone whether to grasp, to scan again or to ask a person, and print the motions of the grasp.

Run: python examples/planner.py [URL]. The service's arm moves. A token comes from POINTCHAIN_TOKEN, if set.
"""

import os
import sys
from collections.abc import Iterable

from pointchain_client import Client, ClientError, Grasp, Model

MORE_DATA_HELPS = {
    "connection-uncertain", "crossing-undecided", "end-unobserved", "possible-string", "scene-changed", "sharp-bend",
    "upper-strand-unseen",
}  # fmt: skip


def obstacle(grasp: Grasp) -> str:
    """Return why the arm cannot carry out a grasp from its home posture. Empty: it can."""
    if grasp.reach is None:
        return "the reach was not determined"
    if not grasp.reach.reachable:
        return grasp.reach.message or "the grasp is not reachable"
    return "" if grasp.reach.path_free else "the path from the home posture to the pre-grasp is not free"


def decide(model: Model, grasps: Iterable[Grasp], may_rescan: bool) -> Grasp | str:
    """Return the first trusted one of the grasps, or what to do instead: `done`, `rescan` or `ask`."""
    if model.quality.verdict == "accept" and not model.chains:
        return "done"
    for grasp in grasps:
        if grasp.trusted and model.trusted(grasp.chain):
            return grasp
    more_data_helps = {finding.code for finding in model.quality.doubts} <= MORE_DATA_HELPS
    return "rescan" if may_rescan and model.quality.doubts and more_data_helps else "ask"


def main(url: str) -> int:
    """Return 0 when a grasp was printed or no string is there, 1 when a person must decide."""
    with Client(url, token=os.environ.get("POINTCHAIN_TOKEN")) as cell:
        for may_rescan in (True, False):
            model = cell.model(cell.scan(string_radius_m=0.0042))
            grasps = cell.grasps(model).grasps
            decision = decide(model, (grasp for grasp in grasps if not obstacle(grasp)), may_rescan)
            if decision != "rescan":
                break
        if isinstance(decision, Grasp):
            assert decision.reach is not None  # by `obstacle`
            if not cell.release().robot.at_home:  # from here on this program may move the arm
                print("ask:", "the arm was stopped and is not home", sep="\n  ", file=sys.stderr)
                return 1
            print(f"chain {decision.chain} at {decision.s_m:.3f} m")
            print("moveJ to", decision.reach.q_pregrasp_rad)
            print(f"open to {decision.opening_m:.4f} m, moveL until the flange is at")
            print(decision.T_base_flange.grasp)
            return 0
    reasons = [finding.message for finding in model.quality.findings]
    reasons += sorted({obstacle(grasp) for grasp in grasps if model.trusted(grasp.chain)} - {""})
    print(f"{decision}:", *reasons, sep="\n  ", file=sys.stderr)
    return 0 if decision == "done" else 1


if __name__ == "__main__":
    try:
        sys.exit(main(sys.argv[1] if len(sys.argv) > 1 else "http://127.0.0.1:8000"))
    except ClientError as error:
        sys.exit(f"planner: {error}")

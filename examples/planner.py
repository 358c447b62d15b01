"""Scan, decide whether to trust the model, take over the arm, and print the best grasp.

Run: python examples/planner.py [URL]. The service's arm moves. A token comes from POINTCHAIN_TOKEN, if set.
"""

import os
import sys

from service.client import Client, ClientError


def main(url: str) -> int:
    """Return 0 when a grasp was printed, 1 when a person must decide."""
    with Client(url, token=os.environ.get("POINTCHAIN_TOKEN")) as cell:
        scan = cell.scan(string_radius_m=0.0042)
        model = cell.model(scan)
        doubts = [*model.quality.ambiguities, *model.quality.warnings]
        if scan.state != "succeeded" or doubts or not model.grasps:
            print(f"scan {scan.id} is {scan.state}, no automatic grasp:", *doubts, sep="\n  ", file=sys.stderr)
            return 1
        cell.release()  # returns when the arm is home: from here on this program may move it
    grasp = model.grasps[0]
    print(f"chain {grasp.chain} at {grasp.s_m:.3f} m, open to {grasp.opening_m:.4f} m, T_base_grasp:")
    print(grasp.T_base_grasp)
    return 0


if __name__ == "__main__":
    try:
        sys.exit(main(sys.argv[1] if len(sys.argv) > 1 else "http://127.0.0.1:8000"))
    except ClientError as error:
        sys.exit(f"planner: {error}")

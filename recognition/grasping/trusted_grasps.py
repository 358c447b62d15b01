"""Selection of the grasps on trusted parts of the chains."""

from collections.abc import Sequence
from dataclasses import replace

from recognition.grasping.grasp_planner import GraspSet
from recognition.grasping.gripper import Gripper
from recognition.model.chains import Chain, Crossing
from recognition.model.findings import Finding, finding
from recognition.model.trust import chain_trust


def select_trusted_grasps(
    candidates: GraspSet,
    chains: Sequence[Chain],
    crossings: Sequence[Crossing],
    findings: Sequence[Finding],
    gripper: Gripper,
    keep_all: bool = False,
) -> GraspSet:
    """Select the grasps where no doubt concerns the part of the chain between the fingers.

    Args:
        candidates: Grasps on the chains.
        chains: Chains of the model.
        crossings: Crossings of the model.
        findings: All findings of the model.
        gripper: Gripper; uses the width of the fingers.
        keep_all: Whether the other grasps are kept, too. Their `trusted` is False.

    Returns:
        The grasps in the same order, with one more note on each chain whose grasps were all removed.
    """
    trusts = {chain.id: chain_trust(chain, crossings, findings) for chain in chains}
    half = gripper.finger_width_m / 2
    marked = [
        replace(grasp, trusted=grasp.trusted and trusts[grasp.chain].is_trusted(grasp.s_m, half))
        for grasp in candidates.grasps
    ]
    if keep_all:
        return GraspSet(tuple(marked), candidates.findings)
    selected = tuple(grasp for grasp in marked if grasp.trusted)
    notes = list(candidates.findings)
    for chain in sorted({grasp.chain for grasp in marked} - {grasp.chain for grasp in selected}):
        count = sum(grasp.chain == chain for grasp in marked)
        message = f"chain {chain} has {count} grasps, but all of them are on parts with a doubt; they are not listed"
        notes.append(finding("no-trusted-grasp", message, chains=(chain,), value=count))
    return GraspSet(selected, tuple(notes))

"""The table of finding codes: severity, meaning, what the finding blocks, what to do, and what a program decides."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

Severity = Literal["note", "doubt", "blocking"]
"""How serious a finding is.

`note`: something was set aside, and the model is not less reliable. `doubt`: the model may be wrong there.
`blocking`: the model is probably wrong there.
"""
Scope = Literal["nothing", "model", "chain", "part", "crossing"]
"""What a doubt or a blocking finding concerns: the completeness of the model, whole chains, a part, or a crossing."""

Decision = Literal["scan again", "recognise again", "ask a person", "nothing"]
"""What a program does about a finding.

`scan again`: another scan, if possible from more views, can resolve it. `recognise again`: recognition of the same
recording with other parameters, or by this version, can resolve it. `ask a person`: another scan would probably have
the same finding. `nothing`: the finding changes no verdict.
"""

FindingCode = Literal[
    "sharp-bend",
    "tight-bend",
    "connection-uncertain",
    "crossing-undecided",
    "upper-strand-unseen",
    "ends-touching",
    "possible-branch",
    "end-unobserved",
    "possible-bar",
    "possible-rod",
    "possible-object",
    "above-table",
    "radius-much-smaller",
    "radius-uncertain",
    "possible-string",
    "string-of-other-radius",
    "table-not-covered",
    "scene-changed",
    "calibration-drift",
    "table-elsewhere",
    "single-view-not-aligned",
    "depth-noise",
    "end-at-border",
    "radius-smaller",
    "radius-larger",
    "no-grasp",
    "no-trusted-grasp",
    "low-objects-hidden",
    "no-string-in-view",
    "no-string-found",
    "piece-too-short",
    "piece-hardly-seen",
    "piece-not-round",
    "piece-in-table",
    "piece-upright",
    "more-pieces",
    "unexplained-surface",
    "more-unexplained-surface",
    "single-view",
    "table-uncertain",
    "depth-warp",
    "stereo-depth-corrected",
    "more-views-needed",
    "view-missing",
    "recording-incomplete",
    "colour-unusable",
    "view-without-depth",
    "view-outside-workspace",
    "view-stuck",
    "view-without-string",
    "view-crowded",
    "view-noisy",
    "view-contradicting",
    "view-pose-error",
]
"""Code of a finding."""


@dataclass(frozen=True)
class FindingType:
    """A type of finding. Its code is its key in `FINDING_TYPES`."""

    severity: Severity
    """Severity of every finding with this code."""
    scope: Scope
    """What a program must not rely on. `nothing` for notes."""
    meaning: str
    """What was found."""
    action: str
    """What a planner or an operator can do about it."""
    decision: Decision
    """What a program does about it. `nothing` for notes."""
    value: str | None = None
    """Meaning and unit of `value`; `limit` has the same unit. None if the finding has no value."""


FINDING_TYPES: Mapping[FindingCode, FindingType] = {
    "sharp-bend": FindingType(
        severity="blocking",
        scope="part",
        meaning="The chain bends more sharply than any string can. It has probably taken the wrong strand.",
        action="Do not rely on the order of the chain, and do not grasp at the bend. Scan again from more views.",
        decision="scan again",
        value="bend angle, rad",
    ),
    "tight-bend": FindingType(
        severity="doubt",
        scope="part",
        meaning="The chain bends as only a string in a tight knot does. It may have taken the wrong strand there.",
        action="If no knot is pulled tight there, do not rely on the order of the chain. Do not grasp at the bend.",
        decision="ask a person",
        value="bend angle, rad",
    ),
    "connection-uncertain": FindingType(
        severity="doubt",
        scope="part",
        meaning="The strands that meet here may be connected differently.",
        action="Do not rely on the order of the chain beyond this part. Scan again from more views.",
        decision="scan again",
        value="margin of this connection over the next best one, squared sigmas",
    ),
    "crossing-undecided": FindingType(
        severity="doubt",
        scope="crossing",
        meaning="Which strand is over is uncertain: the heights differ too little, or both may connect differently.",
        action="Do not pull there. Scan again from more views, or ask a person.",
        decision="scan again",
        value="confidence of the crossing, 0.5 to 1",
    ),
    "upper-strand-unseen": FindingType(
        severity="doubt",
        scope="crossing",
        meaning="The strand that is over by its height was not seen at the crossing, but the other strand was.",
        action="Do not pull there. Scan again from more views, or ask a person.",
        decision="scan again",
        value="confidence of the crossing, 0.5 to 1",
    ),
    "ends-touching": FindingType(
        severity="doubt",
        scope="part",
        meaning="The end faces another end so closely that one string may continue there.",
        action="Check the radius. Treat both ends as connected until a person or another scan has separated them.",
        decision="ask a person",
        value="gap between the ends, m",
    ),
    "possible-branch": FindingType(
        severity="doubt",
        scope="part",
        meaning="An end meets the side of a strand at the same height. They may be joined, as in a cable harness.",
        action="Treat both strands as joined until a person has separated them. Pulling one may move the other.",
        decision="ask a person",
        value="distance of the end from the centre line of the strand, m",
    ),
    "end-unobserved": FindingType(
        severity="doubt",
        scope="part",
        meaning="No view looks into free space ahead of the end, or something in no chain lies there. It may continue.",
        action="Do not pull the string out at this end. Scan again, or remove what hides the end.",
        decision="scan again",
    ),
    "possible-bar": FindingType(
        severity="doubt",
        scope="chain",
        meaning="It may be a bar: the surface does not show that it is round. In stereo depth, each straight chain has "
        "this doubt.",
        action="Ask a person what lies there. If the chain is not straight, scan again from more views.",
        decision="ask a person",
        value="upper bound of the squareness: 0 for a tube, 1 for a bar with sharp edges; absent if only straight",
    ),
    "possible-rod": FindingType(
        severity="doubt",
        scope="chain",
        meaning="The chain is straight and has another radius than given. It may be a pen or a rod.",
        action="Ask a person what lies there, or give the right radius.",
        decision="ask a person",
        value="measured radius, m",
    ),
    "possible-object": FindingType(
        severity="doubt",
        scope="chain",
        meaning="Surface that is in no chain lies along the chain. The chain may be an edge or a fold of an object.",
        action="Ask a person what lies there, or remove the object and scan again.",
        decision="ask a person",
        value="share of the chain with such surface beside it, 0 to 1",
    ),
    "above-table": FindingType(
        severity="doubt",
        scope="chain",
        meaning="The chain lies above what is beside it, and on no strings that support it. It may be an edge.",
        action="Check the table height. Ask a person what lies there.",
        decision="ask a person",
        value="height of the underside above the surface on both sides, m",
    ),
    "radius-much-smaller": FindingType(
        severity="doubt",
        scope="chain",
        meaning="The string is much thinner than the given radius. Parts and ends of thin strings are missed.",
        action="Give the radius of the thinnest string, and recognise the scan again.",
        decision="recognise again",
        value="measured radius, m",
    ),
    "radius-uncertain": FindingType(
        severity="doubt",
        scope="chain",
        meaning="No radius was given, and it was measured in depth of a stereo camera. It can be wrong by a quarter or "
        "more.",
        action="Give the radius of the string, and recognise the scan again. Heights and ends depend on it.",
        decision="recognise again",
        value="measured radius, m",
    ),
    "possible-string": FindingType(
        severity="doubt",
        scope="model",
        meaning="Something that may be a string is in no chain: an excluded piece, or narrow and low surface that no "
        "strand follows.",
        action="Look at it. Check the radius, and give that of the thinnest string. Or scan again from more views.",
        decision="scan again",
        value="length of the piece, m",
    ),
    "string-of-other-radius": FindingType(
        severity="doubt",
        scope="model",
        meaning="Much more string is found with a measured radius than with the given one, which is probably wrong.",
        action="Recognise the scan again with the measured radius or with none. Correct the configured radius.",
        decision="recognise again",
        value="measured radius, m",
    ),
    "table-not-covered": FindingType(
        severity="doubt",
        scope="model",
        meaning="Fewer than two views, or not the only one, show a part of the table. Strings may be missed there.",
        action="Reduce the workspace, or add viewpoints.",
        decision="ask a person",
        value="share of the table that is not covered, 0 to 1",
    ),
    "scene-changed": FindingType(
        severity="doubt",
        scope="chain",
        meaning="The views that were captured last contradict all earlier ones. Something may have moved meanwhile.",
        action="Scan again.",
        decision="scan again",
    ),
    "calibration-drift": FindingType(
        severity="doubt",
        scope="chain",
        meaning="All views agree on a camera pose that is far from the calibrated pose.",
        action="Calibrate again. Until then, all positions may be shifted.",
        decision="ask a person",
        value="distance from the calibrated pose, in sigmas of a good calibration",
    ),
    "table-elsewhere": FindingType(
        severity="doubt",
        scope="chain",
        meaning="The views show the table at another height or tilt than given. The model is relative to this plane.",
        action="Correct the table height or level the table. If it is where it is given, calibrate again.",
        decision="ask a person",
        value="distance of the measured from the given table, in sigmas of the pose errors",
    ),
    "single-view-not-aligned": FindingType(
        severity="doubt",
        scope="chain",
        meaning="The only view shows too little of the table. The camera may have moved.",
        action="Do not act on positions. Check the table height and verify the calibration, or scan from more views.",
        decision="ask a person",
    ),
    "depth-noise": FindingType(
        severity="doubt",
        scope="model",
        meaning="The depth of the table scatters so much that noise can hide a string or look like one.",
        action="Move the viewpoints nearer, use a higher resolution, more exposures, more light, or thicker strings.",
        decision="ask a person",
        value="scatter of the depth of patches, or of pixels, about the table plane, one sigma, m",
    ),
    "end-at-border": FindingType(
        severity="note",
        scope="nothing",
        meaning="The chain ends at the border of the workspace. The string may continue outside.",
        action="Do not pull the string out at this end. Enlarge the workspace if the whole string is needed.",
        decision="nothing",
    ),
    "radius-smaller": FindingType(
        severity="note",
        scope="nothing",
        meaning="The string is thinner than given. Its ends may be short by several sigma, and thinner strings missed.",
        action="Give the radius of the thinnest string.",
        decision="nothing",
        value="measured radius, m",
    ),
    "radius-larger": FindingType(
        severity="note",
        scope="nothing",
        meaning="The string is thicker than the given radius.",
        action="Nothing, or give the right radius.",
        decision="nothing",
        value="measured radius, m",
    ),
    "no-grasp": FindingType(
        severity="note",
        scope="nothing",
        meaning="No position along the chain suits the gripper. The message has the reasons.",
        action="Grasp another chain, use another gripper, or move what is near.",
        decision="nothing",
    ),
    "no-trusted-grasp": FindingType(
        severity="note",
        scope="nothing",
        meaning="The chain has grasps, but only on parts with a doubt. They are not in the model.",
        action="Resolve the doubt, or ask for all grasps.",
        decision="nothing",
        value="number of these grasps",
    ),
    "low-objects-hidden": FindingType(
        severity="note",
        scope="nothing",
        meaning="The measured table is so noisy that low objects on it are hidden.",
        action="Nothing, if no object there is lower than `value`. Otherwise scan from more views, or closer.",
        decision="nothing",
        value="height of the lowest object above the noise, m; at low noise it is `limit`",
    ),
    "no-string-in-view": FindingType(
        severity="note",
        scope="nothing",
        meaning="Nothing in the workspace is higher above the table than the threshold. The model has no chains.",
        action="Nothing, if the table is empty. Otherwise check the radius, the table height and the workspace.",
        decision="nothing",
    ),
    "no-string-found": FindingType(
        severity="note",
        scope="nothing",
        meaning="Nothing above the table is long, round and about as thick as the string. The model has no chains.",
        action="Nothing, if no string is there. Otherwise check the radius.",
        decision="nothing",
    ),
    "piece-too-short": FindingType(
        severity="note",
        scope="nothing",
        meaning="A piece was excluded because it is too short to be distinguished from noise.",
        action="Nothing. If it is the rest of a string, scan again from more views.",
        decision="nothing",
        value="length of the piece, m",
    ),
    "piece-hardly-seen": FindingType(
        severity="note",
        scope="nothing",
        meaning="A short piece was excluded because hardly any surface supports it.",
        action="Nothing. If it is the rest of a string, scan again from more views.",
        decision="nothing",
        value="length of the piece, m",
    ),
    "piece-not-round": FindingType(
        severity="note",
        scope="nothing",
        meaning="A piece was excluded because its surface is not round like a string.",
        action="Nothing, if an object lies there. Otherwise check the radius.",
        decision="nothing",
        value="length of the piece, m",
    ),
    "piece-in-table": FindingType(
        severity="note",
        scope="nothing",
        meaning="A piece was excluded because its tube would reach into the table.",
        action="Nothing, if an object lies there. Otherwise check the table height and the radius.",
        decision="nothing",
        value="length of the piece, m",
    ),
    "piece-upright": FindingType(
        severity="note",
        scope="nothing",
        meaning="A piece was excluded because it stands upright, such as a post.",
        action="Nothing, if an object stands there.",
        decision="nothing",
        value="length of the piece, m",
    ),
    "more-pieces": FindingType(
        severity="note",
        scope="nothing",
        meaning="More pieces were excluded than are listed. Many pieces show that the views do not fit together well.",
        action="Check the calibration if no objects explain the pieces.",
        decision="nothing",
        value="number of further pieces",
    ),
    "unexplained-surface": FindingType(
        severity="note",
        scope="nothing",
        meaning="Something above the table is in no chain: an object, or string that was not recognised.",
        action="Nothing, if an object lies there. The grasps keep clear of it.",
        decision="nothing",
        value="size, m",
    ),
    "more-unexplained-surface": FindingType(
        severity="note",
        scope="nothing",
        meaning="More things above the table are in no chain than are listed.",
        action="Nothing, if objects lie there. The grasps keep clear of them.",
        decision="nothing",
        value="number of further things",
    ),
    "single-view": FindingType(
        severity="note",
        scope="nothing",
        meaning="The model rests on a single view. Only the table plane, and no other view, checks its pose.",
        action="Nothing, if `sigma_m` is small enough. It holds only if calibration and table height are right.",
        decision="nothing",
    ),
    "table-uncertain": FindingType(
        severity="note",
        scope="nothing",
        meaning="The views show the table at another height or tilt than given, hardly more than errors of the poses.",
        action="Nothing, if `sigma_m` is small enough: it contains this error. Else measure the table height again.",
        decision="nothing",
        value="probability that the table is not where it is given",
    ),
    "depth-warp": FindingType(
        severity="note",
        scope="nothing",
        meaning="The camera shows the table curved, in the same way in all views. The depth images were corrected.",
        action="Nothing for this result. Beyond 1 mm, calibrate the camera's lenses again, or let its maker do so.",
        decision="nothing",
        value="root mean square of the depth error on the table, m",
    ),
    "stereo-depth-corrected": FindingType(
        severity="note",
        scope="nothing",
        meaning="Errors that stereo matching leaves in the depth were corrected. The message lists the corrections.",
        action="Nothing for this result. Beyond the radius of the string, move the viewpoints nearer.",
        decision="nothing",
        value="largest correction of depths, heights or ends, m",
    ),
    "more-views-needed": FindingType(
        severity="note",
        scope="nothing",
        meaning="A scan with views as needed went on because something was doubtful. The message says what.",
        action="Nothing. What is still doubtful has findings of its own.",
        decision="nothing",
        value="number of views after which something was doubtful for the last time",
    ),
    "view-missing": FindingType(
        severity="note",
        scope="nothing",
        meaning="The view was not captured: the camera failed there, or the viewpoint was not reachable.",
        action="Nothing, if the other views suffice. If it happens again, plan the viewpoints and read the reasons.",
        decision="nothing",
    ),
    "recording-incomplete": FindingType(
        severity="note",
        scope="nothing",
        meaning="The recording lacks something, for example because it was cut off.",
        action="Nothing, if the complete views suffice. Otherwise copy the file again, or scan again.",
        decision="nothing",
    ),
    "colour-unusable": FindingType(
        severity="note",
        scope="nothing",
        meaning="Colour images of the recording cannot be used. Recognition does not need them.",
        action="Nothing. To have them, write JPEG images.",
        decision="nothing",
    ),
    "view-without-depth": FindingType(
        severity="note",
        scope="nothing",
        meaning="No pixel of the view has a depth.",
        action="If it happens again, check the camera.",
        decision="nothing",
    ),
    "view-outside-workspace": FindingType(
        severity="note",
        scope="nothing",
        meaning="The view measured nothing in the workspace.",
        action="If it happens again, check the viewpoints and the workspace.",
        decision="nothing",
    ),
    "view-stuck": FindingType(
        severity="note",
        scope="nothing",
        meaning="Every pixel of the view has the same depth.",
        action="Check the camera.",
        decision="nothing",
    ),
    "view-without-string": FindingType(
        severity="note",
        scope="nothing",
        meaning="The view has too few points above the table.",
        action="Nothing, if the string is not in the field of view there.",
        decision="nothing",
    ),
    "view-crowded": FindingType(
        severity="note",
        scope="nothing",
        meaning="The view has too many points above the table for a scene of strings.",
        action="If it happens again, check the table height and the workspace.",
        decision="nothing",
    ),
    "view-noisy": FindingType(
        severity="note",
        scope="nothing",
        meaning="The depth of the table scatters so much that most points above the height threshold are noise.",
        action="If it happens again, move the viewpoint nearer, or use a higher resolution, more exposures or light.",
        decision="nothing",
    ),
    "view-contradicting": FindingType(
        severity="note",
        scope="nothing",
        meaning="The view contradicts the other views, and was excluded. Its pose was wrong, or something moved.",
        action="Nothing, if it happens rarely. Otherwise check the arm and the calibration.",
        decision="nothing",
    ),
    "view-pose-error": FindingType(
        severity="note",
        scope="nothing",
        meaning="The view was not captured at the pose that the arm reported, and was excluded.",
        action="Check the arm, and that it is at rest when the camera captures.",
        decision="nothing",
    ),
}
"""All codes, the most serious first."""

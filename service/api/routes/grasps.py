"""Route of the grasps of a scan: a list to choose from, with the reach of the arm."""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from itertools import islice
from typing import Annotated, Any

import numpy as np
from anyio import to_thread
from fastapi import APIRouter, Query, Response
from numpy.typing import NDArray
from pydantic import TypeAdapter, ValidationError

from calibration.storage.hand_eye_file import HandEye
from recognition.grasping.candidates import MAX_RELEVANT_DISTANCE_M
from recognition.grasping.flange_poses import T_flange_tcp
from recognition.grasping.gripper import Gripper
from recognition.model.document import GraspDocument
from service.api.dependencies import Context, Id, Service, find_scan
from service.api.file_responses import NOT_MODIFIED, IfNoneMatch, matches, not_modified_response, stat_file
from service.api.problem_responses import problem_responses
from service.api.response_cache import json_response
from service.api.result_files import damaged, hash_and_size, read_height_map, result_path
from service.api.schemas.addresses import SCANS
from service.api.schemas.calibration_resources import usable_hand_eye
from service.api.schemas.grasps import GraspsDocument, ListedGrasp
from service.problems.problem_error import ProblemError
from service.storage.data_folder import HEIGHT_MAP, MODEL
from service.storage.rows import ScanRow

router = APIRouter(prefix=SCANS, tags=["scans"])

_RESPONSES: dict[int | str, dict[str, Any]] = (
    {200: {"model": GraspsDocument, "content": {"application/json": {}}}}
    | NOT_MODIFIED
    | problem_responses(
        "scan-not-found",
        "no-result",
        "result-not-ready",
        "invalid-parameters",
        "invalid-request",
        "calibration",
        "viewpoints-unreachable",
    )
)
_GRASPS = TypeAdapter(list[GraspDocument])

Chain = Annotated[int | None, Query(ge=0, description="Id of a chain; only its grasps are listed")]
MinS = Annotated[
    float | None,
    Query(ge=0, allow_inf_nan=False, description="Arc length along the chain, metres; grasps from here on"),
]
MaxS = Annotated[
    float | None,
    Query(
        ge=0,
        allow_inf_nan=False,
        description="Arc length along the chain, metres; grasps up to here. On a ring it may be below min_s_m",
    ),
]
MinClearance = Annotated[
    float | None,
    Query(
        ge=0, le=MAX_RELEVANT_DISTANCE_M, description="Minimum clearance_m, metres. 0.03 selects those of 0.03 or more"
    ),
]
Count = Annotated[int | None, Query(ge=1, le=10_000, description="Maximum number of grasps, the first of the list")]
Reachable = Annotated[
    bool | None, Query(description="Only grasps that the arm can, or cannot, carry out. Implies `reach`")
]
Reach = Annotated[
    bool | None,
    Query(
        description="Whether the reach is determined, by the configured cell. Default: for scans with the calibration "
        "that is active and the gripper that is configured"
    ),
]


@dataclass(frozen=True)
class _Choice:
    """What a request asks for."""

    chain: int | None
    min_s_m: float | None
    max_s_m: float | None
    min_clearance_m: float | None
    count: int | None
    reachable: bool | None
    reach: bool | None

    def select(self, grasps: Sequence[GraspDocument]) -> list[GraspDocument]:
        """Return the grasps of the list that meet all conditions but reach and count."""
        return [grasp for grasp in grasps if self._has(grasp)]

    def _has(self, grasp: GraspDocument) -> bool:
        if self.chain is not None and grasp.chain != self.chain:
            return False
        if self.min_clearance_m is not None and grasp.clearance_m < self.min_clearance_m:
            return False
        from_here = self.min_s_m is None or grasp.s_m >= self.min_s_m
        to_here = self.max_s_m is None or grasp.s_m <= self.max_s_m
        if self.min_s_m is not None and self.max_s_m is not None and self.min_s_m > self.max_s_m:
            return from_here or to_here  # across the first point of a ring
        return from_here and to_here


@dataclass(frozen=True)
class _Inputs:
    """Whether a scan was made with what the cell uses now."""

    same_calibration: bool | None
    """Whether its hand-eye calibration is active. None if that is not known."""
    same_gripper: bool
    """Whether its gripper is configured."""


@dataclass(frozen=True)
class _Selection:
    """The selected grasps of a scan, without their reach."""

    scan: ScanRow
    total: int
    grasps: Sequence[GraspDocument]
    gripper: Gripper
    inputs: _Inputs
    etag: str


@router.get("/{id}/grasps", response_model=GraspsDocument, responses=_RESPONSES)
async def get_grasps(
    id: Id,  # noqa: A002 (the path's own name)
    service: Service,
    if_none_match: IfNoneMatch,
    chain: Chain = None,
    min_s_m: MinS = None,
    max_s_m: MaxS = None,
    min_clearance_m: MinClearance = None,
    count: Count = None,
    reachable: Reachable = None,
    reach: Reach = None,
) -> Response:
    """Return the grasps of the strings by the gripper of the scan, the best of each cluster first.

    With reach, the answer says for each grasp whether the arm of the configured cell can carry it out from its home
    posture, with the joint angles, or why not. A recording must then be of this cell: `same_calibration` says whether
    it names the calibration that is active. If another gripper is configured now, reach is refused: recognise the scan
    again. The first 20 grasps take about 0.1 s, and all grasps of a scene up to a second. Filters keep the ids and the
    order.
    """
    choice = _Choice(chain, min_s_m, max_s_m, min_clearance_m, count, reachable, reach)

    def find() -> tuple[_Selection | Response, HandEye | None]:
        scan = find_scan(id, service)
        path = result_path(scan, service, MODEL)
        active = usable_hand_eye(service.cell)
        inputs = _compare_inputs(scan, service, active)
        hand_eye = _hand_eye(scan, service, choice, active, inputs)
        _, of_model = stat_file(path, **hash_and_size(scan, MODEL))
        # 4 is the version of this answer, which differs from that of the model
        etag = f'{of_model[:-1]}-grasps-4-{inputs.same_calibration}-{inputs.same_gripper}"'
        if hand_eye is None and matches(if_none_match, etag):
            return not_modified_response(etag), None
        return _select(scan, service, choice, inputs, etag), hand_eye

    selection, hand_eye = await to_thread.run_sync(find)
    if isinstance(selection, Response):
        return selection
    if hand_eye is None:
        return json_response(_without_reach(selection, choice), headers={"ETag": selection.etag})

    def determine() -> Response:
        return json_response(_with_reach(selection, choice, service, hand_eye), headers={"Cache-Control": "no-cache"})

    return await to_thread.run_sync(determine, limiter=service.planning)


def _compare_inputs(scan: ScanRow, service: Context, active: HandEye | None) -> _Inputs:
    """Return whether a scan was made with the active calibration and the configured gripper."""
    sha256 = scan.calibration_sha256
    if sha256 is None and scan.recording is not None:
        recording = service.store.recording(scan.recording)
        sha256 = None if recording is None else recording.provenance.get("calibration_sha256")
    return _Inputs(
        same_calibration=None if sha256 is None or active is None else sha256 == active.sha256,
        same_gripper=scan.request.gripper == service.config.cell.gripper.to_gripper(),
    )


def _hand_eye(
    scan: ScanRow, service: Context, choice: _Choice, active: HandEye | None, inputs: _Inputs
) -> HandEye | None:
    """Return the calibration with which the reach is determined, or None if it is not.

    Raises:
        ProblemError: `invalid-parameters`: `reachable` is given, and `reach` is false. Or the request asks for the
            reach, and the grasps are for another gripper than the configured one.
        CalibrationError: The request asks for the reach, and there is no usable calibration.
    """
    if choice.reach is False and choice.reachable is not None:
        raise _unfit("`reach` is false, and `reachable` needs the reach: leave one of them out")
    if choice.reach or choice.reachable is not None:
        if not inputs.same_gripper:
            raise _unfit(
                f"the grasps of scan {scan.id} are for another gripper than [gripper] of the configuration has now: "
                "recognise the scan again, by its link `reprocess`"
            )
        return active or service.cell.hand_eye()
    if choice.reach is None and inputs.same_calibration and inputs.same_gripper:
        return active
    return None


def _select(scan: ScanRow, service: Context, choice: _Choice, inputs: _Inputs, etag: str) -> _Selection:
    """Return the grasps that meet the conditions of the request, apart from reach and count.

    Raises:
        ProblemError: `damaged`: The file is not a model. `invalid-parameters`: The conditions do not fit the chains of
            the model.
    """
    path = result_path(scan, service, MODEL)
    try:
        model = json.loads(path.read_bytes())
        grasps = _GRASPS.validate_python(model["grasps"])
        closed = {chain["id"]: chain["closed"] for chain in model["chains"]}
    except (ValidationError, ValueError, KeyError, TypeError, OSError) as error:
        raise damaged(path, scan, error) from error
    _check(choice, closed)
    return _Selection(scan, len(grasps), choice.select(grasps), scan.request.gripper, inputs, etag)


def _check(choice: _Choice, closed: dict[int, bool]) -> None:
    """Check the conditions against the chains of a model, given whether each is closed, by its id.

    Raises:
        ProblemError: `invalid-parameters`: The chain does not exist, or the range of arc lengths is not one of a chain.
    """
    if choice.chain is not None and choice.chain not in closed:
        raise _unfit(f"the model has no chain {choice.chain}; its chains are {sorted(closed)}")
    low, high = choice.min_s_m, choice.max_s_m
    if (low is not None or high is not None) and choice.chain is None:
        name = "min_s_m" if low is not None else "max_s_m"
        raise _unfit(f"{name} is an arc length along a chain: give `chain`, too")
    if low is not None and high is not None and low > high and not closed[choice.chain or 0]:
        raise _unfit(f"max_s_m is {high:g}, less than min_s_m, {low:g}, and chain {choice.chain} is not a ring")


def _without_reach(selection: _Selection, choice: _Choice) -> GraspsDocument:
    grasps = [ListedGrasp.of(document, None, selection.gripper) for document in selection.grasps[: choice.count]]
    return _document(selection, grasps, None)


def _with_reach(selection: _Selection, choice: _Choice, service: Context, hand_eye: HandEye) -> GraspsDocument:
    """Return the grasps with their reach. Only as many are checked as the answer needs."""
    scan, gripper, finder = selection.scan, selection.gripper, service.reach
    heights = None
    if HEIGHT_MAP in (scan.files or {}):
        stored = read_height_map(scan, service)
        heights = stored.heights, stored.table_z_m
    candidates = selection.grasps if choice.reachable is not None else selection.grasps[: choice.count]
    found = finder.find(scan.id, [document.to_grasp() for document in candidates], gripper, hand_eye, heights)
    matching = (
        ListedGrasp.of(document, reach, gripper)
        for document, (_, reach) in zip(candidates, found, strict=True)
        if choice.reachable is None or reach.reachable == choice.reachable
    )
    return _document(selection, list(islice(matching, choice.count)), finder.home_q_rad(hand_eye))


def _document(
    selection: _Selection, grasps: list[ListedGrasp], q_home_rad: NDArray[np.float64] | None
) -> GraspsDocument:
    T = T_flange_tcp(selection.gripper).round(9) + 0.0  # no -0.0
    values = {"total": selection.total, "T_flange_tcp": T.tolist(), "q_home_rad": q_home_rad, "grasps": grasps}
    return GraspsDocument.model_validate(
        {"schema": "pointchain/2", "frame": "base"} | asdict(selection.inputs) | values
    )


def _unfit(message: str) -> ProblemError:
    return ProblemError("invalid-parameters", message)

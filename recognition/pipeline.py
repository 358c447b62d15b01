"""Recognition pipeline: from depth views to the point chain model, in the order of the paper's flowchart (Fig. 2)."""

from collections.abc import Callable, Iterable

from recognition.assembly.checked_chains import check_chains
from recognition.grasping.grasping import plan_grasps
from recognition.ingestion.table_and_warp import TableAndWarp
from recognition.methods import find_chains
from recognition.model.model import PointChainModel
from recognition.model.quality import Quality
from recognition.preprocessing.target_cloud import DepthView, Scene
from recognition.radii.radius_measurement import measure_radius
from recognition.request import RecognitionRequest
from recognition.result import Recognition, in_base_frame
from recognition.scene_findings import findings_without_string, scene_findings
from recognition.stage_timer import StageTimer
from recognition.surface import observe

DEFAULT_REQUEST = RecognitionRequest()
"""Request for the method `graph`, a radius that is measured, and the default gripper."""
DEFAULT_SCENE = Scene()
"""A table at z = 0 without a workspace limit."""


def recognise(
    views: Iterable[DepthView],
    request: RecognitionRequest = DEFAULT_REQUEST,
    scene: Scene = DEFAULT_SCENE,
    *,
    on_stage: Callable[[str], None] | None = None,
    earlier: Recognition | None = None,
) -> Recognition:
    """Recognise the strings in `views` and return their point chain model, with the results of each stage.

    Args:
        views: Depth images with their camera poses, at least one. They may arrive one by one; each view is
            preprocessed when it arrives. Without a given radius, all of them are needed first.
        request: Method, radius, settings, gripper, and whether grasps in doubt are listed.
        scene: Table height and workspace in the base frame.
        on_stage: Function that is called with the name of each stage (see `STAGES`) when the stage begins.
        earlier: Recognition of the first of these views. What it measured in them is used again.

    Returns:
        The model, in metres and in the base frame, and the results of the stages. If the scene has no string, the model
        has no chains and a finding with the reason.

    Raises:
        InvalidParametersError: The method is unknown, it does not use a setting, the radius is not that of a string, or
            the values break a condition of Table I.
        DuplicateViewError: Two views have the same index.
        InsufficientViewsError: No view was given, or only one view shows a string and others show a bare table.
        ContradictingViewsError: No majority of the views shows the same scene.
        DepthNoiseError: The depth of the table scatters too much for the radius.
        NoDepthError: No view measured anything in the workspace.
        TableElsewhereError: The views show the table too far from where it is given, two planes may be the table, or
            there is no string and all that the views show is far from the given table.
        TooCrowdedError: The points above the table are too many for a scene of strings.
        RadiusUnknownError: No radius is given, and it could not be measured.

    Example:
        >>> from cell.simulation.rendering.depth_camera import camera_model
        >>> from cell.simulation.scenes.scenes import make_scene
        >>> from cell.simulation.offline_scan import simulate
        >>> from recognition.preprocessing import Scene
        >>> from recognition.request import RecognitionRequest
        >>> scan = simulate(make_scene("loop", seed=1), camera_model("ideal"), seed=1)
        >>> scene = Scene(workspace_m=scan.header.workspace_m)
        >>> model = recognise(scan.views, RecognitionRequest(radius_m=0.0042), scene).model
        >>> [(round(chain.length_m, 2), chain.ends) for chain in model.chains]
        [(0.4, ('free', 'free'))]
        >>> model.gauss_code()
        [[[0, 'under', 1], [0, 'over', 1]]]

    Source:
        Flowchart of Fig. 2. The method `graph` is not in the paper.
    """
    request.check()
    timer = StageTimer(on_stage)
    timer.begin("preprocess")
    arriving = timer.exclude_waiting(views)
    radius_m = request.radius_m
    if radius_m is None:
        # Table and warp are measured in all views here, and again one by one below, so that a measured radius gives the
        # same model as a given one of the same value.
        arriving = list(arriving)
        radius_m = measure_radius(TableAndWarp.measure(arriving, scene)).radius_m
    parameters = request.parameters_for(radius_m)

    known = None if earlier is None else earlier.surface
    surface = observe(arriving, scene, parameters, begin=timer.begin, earlier=known)
    if surface.no_string_reason is not None:
        findings = findings_without_string(surface, request)
        timer.end()
        quality = Quality.of(surface.views_quality, findings)
        model = PointChainModel(request.method, parameters, quality=quality, timing_s=timer.timing_s)
        return in_base_frame(Recognition(model, surface))

    found = find_chains(surface, request.method, timer.begin)
    checked = check_chains(found.chains, found.crossings.crossings, surface)
    findings = scene_findings(surface, found, checked, request)

    timer.begin("grasps")
    grasping = plan_grasps(checked, surface, findings, request.gripper, request.all_grasps)
    timer.end()

    model = PointChainModel(
        method=request.method,
        parameters=parameters,
        chains=checked.chains,
        crossings=checked.crossings,
        quality=Quality.of(surface.views_quality, (*findings, *grasping.findings)),
        timing_s=timer.timing_s,
        grasps=grasping.grasps,
    )
    recognition = Recognition(
        model=model,
        surface=surface,
        registration=surface.registration,
        height_map=surface.support.heights,
        stages=found.stages,
        grasping=grasping,
    )
    return in_base_frame(recognition)

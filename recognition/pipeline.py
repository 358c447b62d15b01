"""Recognition pipeline: from depth views to the point chain model, in the order of the paper's flowchart (Fig. 2)."""

import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from recognition.assembly.branches import mark_branches
from recognition.assembly.chain_ends import (
    mark_touching_ends,
    mark_unobserved_ends,
    mark_unseen_ends,
    unobserved_end_findings,
)
from recognition.assembly.chains import assemble_fitted_chains
from recognition.assembly.connections import connection_findings
from recognition.assembly.crossings import find_crossings, find_fitted_crossings
from recognition.assembly.sharp_bends import sharp_bend_findings
from recognition.assembly.table_frame import (
    add_table_error,
    move_heights,
    move_model,
    move_registration,
    table_findings,
)
from recognition.assembly.unexplained import (
    find_unexplained_surface,
    possible_object_findings,
    unexplained_findings,
)
from recognition.assembly.view_findings import (
    drift_findings,
    noise_findings,
    single_view_findings,
    view_findings,
    warp_findings,
)
from recognition.centre_line import CentreLine, estimate_centre_line
from recognition.errors import InvalidParametersError
from recognition.grasping.grasping import Grasping, plan_grasps
from recognition.grasping.gripper import Gripper
from recognition.ingestion.view_ingestion import IngestedViews, ingest_views, merge_heights
from recognition.model.chains import Chain
from recognition.model.findings import Finding, finding, most_serious_first
from recognition.model.model import METHODS, Method, PointChainModel
from recognition.model.quality import Quality
from recognition.parameters import ChainParameters, check_settings
from recognition.preprocessing.coverage import coverage_findings
from recognition.preprocessing.height_map import HeightMap
from recognition.preprocessing.normals import NormalCloud
from recognition.preprocessing.support_surface import SupportSurface
from recognition.preprocessing.target_cloud import DepthView, Scene, TargetCloud
from recognition.radii.radius_estimation import estimate_parameters, other_radius_findings
from recognition.radii.thicker_strings import find_thicker_strings
from recognition.refinement.refinement import Refinement, refine
from recognition.registration.registration import Registration, register
from recognition.shirakawa.chains import assemble_chains
from recognition.shirakawa.enhanced_matching import EnhancedMatching
from recognition.shirakawa.method_stages import LinkedSegments, connect_segments, link_segments
from recognition.shirakawa.reconstruction import Reconstruction
from recognition.tracing.occlusion_map import OcclusionMap
from recognition.tracing.trace import TracedStrands, trace_strands

STAGES = ("preprocess", "registration", "centre_line", "matching", "reconstruction", "refinement", "topology", "grasps")
"""Names of all stages in order, as in `on_stage` and `timing_s`. `stages_of` returns the stages of one method."""


def stages_of(method: Method) -> tuple[str, ...]:
    """Return the stage names of one method: `graph` has `refinement`, the other methods have `reconstruction`."""
    return tuple(stage for stage in STAGES if stage != ("reconstruction" if method == "graph" else "refinement"))


@dataclass(frozen=True, eq=False)
class Recognition:
    """Model of a scene, and the result of each stage. The results of stages that did not run are None or empty.

    If the table is not where it is given, the stages work in the frame in which it is (see `IngestedViews`). The model,
    the registration and the height map are in the base frame in any case.
    """

    model: PointChainModel
    """The point chain model."""
    ingested: IngestedViews
    """Preprocessed views."""
    registration: Registration | None = None
    """Registered views, and their merged point cloud with normals."""
    centre_line: CentreLine | None = None
    """Centre points (eq. 1) and their means (eq. 2)."""
    thinned: NDArray[np.float64] | None = None
    """(N, 3) thinned points (eq. 3) of the method `enhanced`, metres, base frame."""
    enhanced: EnhancedMatching | None = None
    """Segments, contribution rates and bifurcation centres of the method `enhanced`."""
    segments: Sequence[NDArray[np.float64]] = ()
    """(N, 3) points of each segment before reconstruction, for `matching` and `enhanced`, metres, base frame."""
    reconstruction: Reconstruction | None = None
    """Strands of the method `enhanced` after each step of the reconstruction."""
    graph: TracedStrands | None = None
    """Nodes, fragments, pairs of ends and strands of the method `graph`."""
    refinement: Refinement | None = None
    """Strands of the method `graph` after the tube fit."""
    height_map: HeightMap | None = None
    """Height of the table and of all that lies on it, from all views."""
    grasping: Grasping | None = None
    """Grasps, and the floor for the fingertips."""

    @property
    def targets(self) -> Sequence[TargetCloud]:
        """Points of each view above the height threshold."""
        return self.ingested.targets

    @property
    def clouds(self) -> Sequence[NormalCloud]:
        """Points and normals of each view that shows a string, before registration."""
        return self.ingested.clouds


@dataclass
class _StageTimer:
    """Timer that measures the duration of each stage and calls `on_stage` when a stage begins."""

    on_stage: Callable[[str], None] | None
    timing_s: dict[str, float] = field(default_factory=dict)
    _stage: str | None = None
    _begin_s: float = 0.0

    def begin(self, stage: str) -> None:
        """End the current stage and begin the next one."""
        self.end()
        self._stage, self._begin_s = stage, time.perf_counter()
        if self.on_stage is not None:
            self.on_stage(stage)

    def end(self) -> None:
        """End the current stage and store its duration. Without a current stage, do nothing."""
        if self._stage is not None:
            self.timing_s[self._stage] = time.perf_counter() - self._begin_s
        self._stage = None

    def exclude_waiting(self, views: Iterable[DepthView]) -> Iterator[DepthView]:
        """Yield the views. The stage's duration excludes the wait for each view, because the arm moves meanwhile."""
        iterator = iter(views)
        while True:
            requested_s = time.perf_counter()
            view = next(iterator, None)
            self._begin_s += time.perf_counter() - requested_s
            if view is None:
                return
            yield view


def recognise(
    views: Iterable[DepthView],
    parameters: ChainParameters | None = None,
    scene: Scene | None = None,
    method: Method = "graph",
    on_stage: Callable[[str], None] | None = None,
    gripper: Gripper | None = None,
    settings: Mapping[str, float] | None = None,
    all_grasps: bool = False,
    earlier: Recognition | None = None,
) -> Recognition:
    """Recognise the strings in `views` and return their point chain model, with the results of each stage.

    Args:
        views: Depth images with their camera poses, at least one. They may arrive one by one; each view is
            preprocessed when it arrives.
        parameters: Radii and thresholds. None measures the radius of the strings first. The measurement needs all
            views and doubles the computing time. It is also made, for a finding, if a given radius gives no chain or
            a chain that is thinner.
        scene: Table height and workspace in the base frame. None means a table at z = 0 and no workspace limit.
        method: `"matching"` is the earlier method of the paper's authors. `"enhanced"` is the method of the paper.
            `"graph"` is our method.
        on_stage: Function that is called with the name of each stage (see `STAGES`) when the stage begins.
        gripper: Gripper for the grasps. None means the default gripper.
        settings: Parameter values by name. They replace the values in `parameters`, or the values for the measured
            radius. The measurement of the radius ignores `settings`.
        all_grasps: Whether the model also has the grasps on parts of chains with a doubt.
        earlier: Recognition of the first of these views. Their preprocessing is used again if the parameters are equal.

    Returns:
        The model, in metres and in the base frame, and the results of the stages. If the scene has no string, the model
        has no chains and a finding with the reason.

    Raises:
        InvalidParametersError: The method is unknown, it does not use one of `settings`, or the values break a
            condition of Table I.
        DuplicateViewError: Two views have the same index.
        InsufficientViewsError: No view was given, or only one view shows a string and others show a bare table.
        ContradictingViewsError: No majority of the views shows the same scene.
        DepthNoiseError: The depth of the table scatters too much for the radius.
        NoDepthError: No view measured anything in the workspace.
        TableElsewhereError: The views show the table too far from where it is given, two planes may be the table, or
            there is no string and all that the views show is far from the given table.
        TooCrowdedError: The points above the table are too many for a scene of strings.
        RadiusUnknownError: `parameters` is None, and the radius could not be measured.

    Example:
        >>> from cell.simulation.rendering.depth_camera import camera_model
        >>> from cell.simulation.scenes.scenes import make_scene
        >>> from cell.simulation.offline_scan import simulate
        >>> from recognition.parameters import ChainParameters
        >>> from recognition.preprocessing import Scene
        >>> scan = simulate(make_scene("loop", seed=1), camera_model("oak-d-pro"), seed=1)
        >>> scene = Scene(workspace_m=scan.header.workspace_m)
        >>> model = recognise(scan.views, ChainParameters.for_radius(0.0042), scene).model
        >>> [(round(chain.length_m, 2), chain.ends) for chain in model.chains]
        [(0.4, ('free', 'free'))]
        >>> model.gauss_code()
        [[[0, 'under', 1], [0, 'over', 1]]]

    Source:
        Flowchart of Fig. 2. The method `graph` is not in the paper.
    """
    settings = settings or {}
    _check_request(method, settings)
    scene = scene or Scene()
    timer = _StageTimer(on_stage)

    timer.begin("preprocess")
    views = timer.exclude_waiting(views)
    measured = parameters is None
    if parameters is None:
        views = list(views)
        parameters = estimate_parameters(views, scene)
    parameters = parameters.with_settings(settings)
    ingested = ingest_views(views, parameters, scene, None if earlier is None else earlier.ingested)
    if ingested.no_string_reason is not None:
        return _without_string(ingested, method, parameters, scene, timer, measured)

    timer.begin("registration")
    registration = register(ingested.clouds, parameters, ingested.correspondences, table_z_m=scene.table_z_m)
    registration = add_table_error(registration, ingested.table)
    support = SupportSurface(scene.table_z_m, merge_heights(ingested, registration))

    timer.begin("centre_line")
    centre_line = estimate_centre_line(registration.points, registration.normals, parameters)

    timer.begin("matching")
    graph, refinement, reconstruction = None, None, None
    linked = LinkedSegments(())
    if method == "graph":
        occlusion_map = OcclusionMap(registration.points, registration.clouds)
        graph = trace_strands(centre_line.unaveraged, occlusion_map, parameters, support.table_z_m)

        timer.begin("refinement")
        refinement = refine(
            graph.strands,
            registration.points,
            registration.normals,
            parameters,
            support,
            views=registration.clouds,
            bends=graph.pairing.bends,
        )
        strings = find_thicker_strings(graph, refinement, registration, occlusion_map, support, parameters)

        timer.begin("topology")
        assembly = assemble_fitted_chains(strings.passes, registration, occlusion_map, scene, parameters, support)
        connections = connection_findings(strings.ambiguous, assembly.chains)
        crossings = find_fitted_crossings(assembly.chains, connections)
    else:
        linked = link_segments(method, centre_line.points, parameters)

        timer.begin("reconstruction")
        strands, reconstruction = connect_segments(linked, registration.points, centre_line.unaveraged, parameters)

        timer.begin("topology")
        assembly = assemble_chains(strands, centre_line.unaveraged, registration.clouds, scene, parameters)
        crossings = find_crossings(assembly.strands, registration.points, parameters)
        connections = []

    surface = support.remove_from(registration.points, assembly.chains, parameters)
    unexplained = find_unexplained_surface(surface, assembly.chains, parameters)
    chains, contacts = _mark_ends(assembly.chains, unexplained, registration.clouds, parameters)
    findings = (
        *(() if measured else other_radius_findings(ingested.views, scene, parameters, chains, assembly.findings)),
        *crossings.findings,
        *connections,
        *sharp_bend_findings(chains),
        *assembly.findings,
        *possible_object_findings(unexplained, chains, parameters),
        *contacts,
        *unobserved_end_findings(chains, scene, parameters),
        *unexplained_findings(unexplained, parameters),
        *drift_findings(registration, chains),
        *table_findings(ingested.table, chains),
        *warp_findings(ingested.warp),
        *single_view_findings(registration.views, ingested.clouds, chains),
        *noise_findings(registration, parameters),
        *view_findings(registration.views + ingested.excluded, [target.view for target in ingested.targets], chains),
        *coverage_findings(ingested.targets, [view.index for view in registration.views if view.used], scene),
    )

    timer.begin("grasps")
    grasping = plan_grasps(
        chains, crossings.crossings, surface, support, findings, parameters, gripper or Gripper(), all_grasps
    )
    timer.end()

    model = PointChainModel(
        method=method,
        parameters=parameters,
        chains=chains,
        crossings=tuple(crossings.crossings),
        quality=Quality(
            views=tuple(sorted(registration.views + ingested.excluded, key=lambda view: view.index)),
            findings=most_serious_first((*findings, *grasping.findings)),
        ),
        timing_s=timer.timing_s,
        grasps=grasping.grasps,
    )
    return _in_base_frame(
        Recognition(
            model=model,
            ingested=ingested,
            registration=registration,
            centre_line=centre_line,
            thinned=linked.thinned,
            enhanced=linked.enhanced,
            segments=linked.segments,
            reconstruction=reconstruction,
            graph=graph,
            refinement=refinement,
            height_map=support.heights,
            grasping=grasping,
        )
    )


def _mark_ends(
    chains: Sequence[Chain],
    unexplained: Sequence[NDArray[np.float64]],
    views: Sequence[NormalCloud],
    parameters: ChainParameters,
) -> tuple[tuple[Chain, ...], list[Finding]]:
    """Mark the ends at which the string may continue, or which may be joined to another strand.

    Returns:
        The chains with the marked ends, and the findings on ends that may be joined.
    """
    chains = mark_unobserved_ends(chains, unexplained, parameters)
    chains, touching = mark_touching_ends(chains, views)
    chains, branches = mark_branches(chains, views)
    return mark_unseen_ends(chains, views, parameters), [*touching, *branches]


def _check_request(method: str, settings: Mapping[str, float]) -> None:
    """Raise InvalidParametersError if the method is unknown, or if it does not use one of the settings."""
    if method not in METHODS:
        raise InvalidParametersError(f"there is no method {method!r}; it must be one of {', '.join(METHODS)}")
    check_settings(settings, method)


def _in_base_frame(recognition: Recognition) -> Recognition:
    """Return the recognition with its model, registration and height map in the base frame."""
    table, registration, heights = (
        recognition.ingested.moved_table,
        recognition.registration,
        recognition.height_map,
    )
    if table is None:
        return recognition
    T = table.T_base_table
    return replace(
        recognition,
        model=move_model(recognition.model, T),
        registration=None if registration is None else move_registration(registration, T),
        height_map=None if heights is None else move_heights(heights, T),
    )


def _without_string(
    ingested: IngestedViews,
    method: Method,
    parameters: ChainParameters,
    scene: Scene,
    timer: _StageTimer,
    measured: bool,
) -> Recognition:
    """Return a model without chains, with the reason and the findings on another radius and on table coverage."""
    assert ingested.no_string_reason is not None
    findings = (
        *(() if measured else other_radius_findings(ingested.views, scene, parameters, (), ())),
        finding("no-string-in-view", ingested.no_string_reason),
        *table_findings(ingested.table, ()),
        *warp_findings(ingested.warp),
        *view_findings(ingested.excluded, [target.view for target in ingested.targets], ()),
        *coverage_findings(ingested.targets, (), scene),
    )
    timer.end()
    quality = Quality(ingested.excluded, most_serious_first(findings))
    model = PointChainModel(method, parameters, quality=quality, timing_s=timer.timing_s)
    return _in_base_frame(Recognition(model, ingested))

"""Recognition from the views to the model, in the order of the flowchart of the paper (Fig. 2)."""

import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from recognition.assembly.chains import assemble_fitted_chains
from recognition.assembly.crossings import find_crossings
from recognition.assembly.fitted_crossings import find_fitted_crossings
from recognition.assembly.missed_ends import mark_unobserved_ends
from recognition.assembly.torn_ends import mark_fragmented_ends
from recognition.assembly.unexplained import find_unexplained_surface, unexplained_messages
from recognition.centre_line import CentreLine, estimate_centre_line
from recognition.errors import InvalidParametersError
from recognition.grasping.grasp_planner import find_grasps
from recognition.grasping.gripper import Gripper
from recognition.model.model import METHODS, Chain, Crossing, Method, PointChainModel, Quality
from recognition.parameters import ChainParameters, check_settings
from recognition.preprocessing.coverage import coverage_warnings
from recognition.preprocessing.normals import NormalCloud
from recognition.preprocessing.target_cloud import DepthView, Scene, TargetCloud
from recognition.radius_estimation import estimate_parameters
from recognition.refinement.refinement import Refinement, refine
from recognition.registration.registration import Registration, register
from recognition.shirakawa.chains import assemble_chains, sharp_bend_messages
from recognition.shirakawa.end_extension import extend_ends
from recognition.shirakawa.enhanced_matching import EnhancedMatching, match_enhanced
from recognition.shirakawa.matching import match_points
from recognition.shirakawa.reconstruction import Reconstruction, reconstruct
from recognition.shirakawa.thinning import thin
from recognition.strand import Strand
from recognition.tracing.height_map import HeightMap
from recognition.tracing.trace import TracedStrands, pairing_messages, trace_strands
from recognition.view_ingestion import ingest_views

STAGES = ("preprocess", "registration", "centre_line", "matching", "reconstruction", "refinement", "topology", "grasps")
"""Names of the stages in `on_stage` and `timing_s`, in order. `stages_of` returns those of one method."""


def stages_of(method: Method) -> tuple[str, ...]:
    """Return the names of the stages of one method: `graph` has `refinement`, the others `reconstruction`."""
    return tuple(stage for stage in STAGES if stage != ("reconstruction" if method == "graph" else "refinement"))


@dataclass(frozen=True, eq=False)
class Recognition:
    """A model and the results of the stages that led to it. Stages that the method does not have are None or empty."""

    model: PointChainModel
    """The result."""
    targets: Sequence[TargetCloud] = ()
    """Points above the height threshold, for each view."""
    clouds: Sequence[NormalCloud] = ()
    """Points with normals, for each view that sees a string, before registration."""
    registration: Registration | None = None
    """The combined point cloud with normals."""
    centre_line: CentreLine | None = None
    """Centre points (eq. 1) and their means (eq. 2)."""
    thinned: NDArray[np.float64] | None = None
    """(N, 3) thinned points (eq. 3) of `enhanced`, metres."""
    enhanced: EnhancedMatching | None = None
    """Segments, contribution rates and bifurcation centres of `enhanced`."""
    segments: Sequence[NDArray[np.float64]] = ()
    """(N, 3) each, the linked points of `matching` and `enhanced` before reconstruction, metres."""
    reconstruction: Reconstruction | None = None
    """The strands of `enhanced` after each step of the reconstruction."""
    graph: TracedStrands | None = None
    """Nodes, fragments, pairs of ends and strands of `graph`."""
    refinement: Refinement | None = None
    """The fitted tubes of `graph`."""


@dataclass(frozen=True, eq=False)
class _Found:
    """What a method made of the centre line, and the stages that led to it."""

    chains: tuple[Chain, ...]
    crossings: Sequence[Crossing]
    ambiguities: Sequence[str]
    warnings: Sequence[str]
    stages: dict[str, Any]
    """Fields of `Recognition`."""


@dataclass
class _Clock:
    """Tells the listener which stage begins, and keeps how long each took."""

    on_stage: Callable[[str], None] | None
    timing_s: dict[str, float] = field(default_factory=dict)
    _stage: str | None = None
    _since: float = 0.0

    def begin(self, stage: str | None) -> None:
        now = time.perf_counter()
        if self._stage is not None:
            self.timing_s[self._stage] = now - self._since
        self._stage, self._since = stage, now
        if stage is not None and self.on_stage is not None:
            self.on_stage(stage)

    def besides_waiting(self, views: Iterable[DepthView]) -> Iterator[DepthView]:
        """The views; the stage does not count how long each is waited for: an arm moves meanwhile."""
        coming = iter(views)
        while True:
            asked = time.perf_counter()
            view = next(coming, None)
            self._since += time.perf_counter() - asked
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
) -> Recognition:
    """Recognise the strings in `views` and return their point chain model, with the results of each stage.

    Args:
        views: Depth images with their camera poses, at least two. They may arrive one by one; each is preprocessed
            when it arrives.
        parameters: Radii and thresholds. None: the radius of the strings is measured first, which needs all views and
            twice the time.
        scene: Height of the table and workspace in the base frame. None: a table at z = 0, and no limit.
        method: `"matching"` is the earlier method of the paper's authors, `"enhanced"` the method of the paper, and
            `"graph"` ours.
        on_stage: Called with the name of each stage (`STAGES`) when it begins.
        gripper: Gripper for the grasps. None: the default gripper.
        settings: Parameter values by name, in place of those of `parameters` or of those for the measured radius. The
            measurement of the radius does not use them.

    Returns:
        The model, in metres and in the base frame, and the results of the stages. A scene without a string gives a
        model without chains, and a warning that says why.

    Raises:
        InvalidParametersError: The method is unknown, it does not use one of `settings`, or the values break a
            condition of Table I.
        DuplicateViewError: Two views have the same index.
        InsufficientViewsError: Fewer than two views were given, or fewer can be used.
        ContradictingViewsError: No majority of the views shows the same scene.
        NoDepthError: No view measured anything in the workspace.
        TooCrowdedError: Much more than strings is above the table.
        RadiusUnknownError: No parameters were given, and no radius could be measured.

    Example:
        >>> from cell.simulation.camera import camera_model
        >>> from cell.simulation.scenes import make_scene
        >>> from cell.simulation.simulate import simulate
        >>> from recognition.parameters import ChainParameters
        >>> from recognition.preprocessing.target_cloud import Scene
        >>> scan = simulate(make_scene("loop", seed=1), camera_model("oak-d-pro"), seed=1)
        >>> scene = Scene(workspace_m=scan.header.workspace_m)
        >>> model = recognise(scan.views, ChainParameters.for_radius(0.0042), scene).model
        >>> [(round(chain.length_m, 2), chain.ends) for chain in model.chains]
        [(0.4, ('free', 'free'))]
        >>> model.gauss_code()
        [[[0, 'under', 1], [0, 'over', 1]]]

    Source:
        The flowchart of Fig. 2, with stages of ours.
    """
    if method not in METHODS:
        raise InvalidParametersError(f"there is no method {method!r}; it must be one of {', '.join(METHODS)}")
    settings = settings or {}
    check_settings(settings, method)
    scene = scene or Scene()
    clock = _Clock(on_stage)

    clock.begin("preprocess")
    views = clock.besides_waiting(views)
    if parameters is None:
        views = list(views)
        parameters = estimate_parameters(views, scene)
    parameters = parameters.with_settings(settings)
    arrivals = ingest_views(views, parameters, scene)
    if arrivals.empty_because is not None:
        clock.begin(None)
        unseen = coverage_warnings(arrivals.targets, (), scene)
        quality = Quality(arrivals.left_out, warnings=(arrivals.empty_because, *unseen))
        return Recognition(PointChainModel(method, parameters, (), (), quality, clock.timing_s), arrivals.targets)

    clock.begin("registration")
    registration = register(arrivals.clouds, parameters, arrivals.pairs)

    clock.begin("centre_line")
    centre_line = estimate_centre_line(registration.points, registration.normals, parameters)

    if method == "graph":
        found = _by_graph(registration, centre_line, parameters, scene, clock)
    else:
        found = _by_sequences(method, registration, centre_line, parameters, scene, clock)
    rest = find_unexplained_surface(registration.points, found.chains, parameters)
    chains, torn = mark_fragmented_ends(mark_unobserved_ends(found.chains, rest, parameters))
    unseen = coverage_warnings(arrivals.targets, [view.index for view in registration.views if view.used], scene)

    clock.begin("grasps")
    grasps, ungraspable = find_grasps(
        chains, found.crossings, registration.points, scene, parameters, gripper or Gripper()
    )
    clock.begin(None)

    views_told = tuple(sorted(registration.views + arrivals.left_out, key=lambda view: view.index))
    # What is wrong with the strings themselves comes before what was in the way of seeing them.
    warnings = (*found.warnings, *registration.warnings, *unseen, *unexplained_messages(rest), *ungraspable)
    quality = Quality(views_told, (*found.ambiguities, *torn), warnings)
    model = PointChainModel(method, parameters, chains, tuple(found.crossings), quality, clock.timing_s, grasps=grasps)
    return Recognition(model, arrivals.targets, arrivals.clouds, registration, centre_line, **found.stages)


def _by_sequences(
    method: Method,
    registration: Registration,
    centre_line: CentreLine,
    parameters: ChainParameters,
    scene: Scene,
    clock: _Clock,
) -> _Found:
    """The paper's methods: points linked one after the other (II.G and III)."""
    clock.begin("matching")
    thinned = enhanced = reconstruction = None
    if method == "matching":
        segments = [centre_line.points[segment] for segment in match_points(centre_line.points, parameters)]
    else:
        thinned = thin(centre_line.points, parameters)
        enhanced = match_enhanced(thinned, parameters)
        segments = [thinned[segment] for segment in enhanced.segments]

    clock.begin("reconstruction")
    if enhanced is None:
        strands = [Strand(points, np.zeros(len(points), dtype=bool)) for points in segments]
    else:
        reconstruction = reconstruct(segments, enhanced.bifurcation_centres, registration.points, parameters)
        strands = extend_ends(reconstruction.connected, centre_line.single, parameters)

    clock.begin("topology")
    strands, chains, warnings = assemble_chains(strands, centre_line.single, registration.clouds, scene, parameters)
    crossings, ambiguities = find_crossings(strands, registration.points, parameters)
    stages = {"thinned": thinned, "enhanced": enhanced, "segments": segments, "reconstruction": reconstruction}
    return _Found(chains, crossings, [*ambiguities, *sharp_bend_messages(chains)], warnings, stages)


def _by_graph(
    registration: Registration, centre_line: CentreLine, parameters: ChainParameters, scene: Scene, clock: _Clock
) -> _Found:
    """Our method: strands as paths in a graph, joined all at once, and fitted to the surface."""
    clock.begin("matching")
    cover = HeightMap(registration.points)
    graph = trace_strands(centre_line.single, cover, parameters)

    clock.begin("refinement")
    refinement = refine(graph.strands, registration.points, registration.normals, parameters, scene.table_z_m)

    clock.begin("topology")
    chains, doubts, warnings = assemble_fitted_chains(refinement, registration, cover, scene, parameters)
    crossings, ambiguities = find_fitted_crossings(chains)
    ambiguities = [*ambiguities, *pairing_messages(graph.pairing), *sharp_bend_messages(chains), *doubts]
    return _Found(chains, crossings, ambiguities, warnings, {"graph": graph, "refinement": refinement})

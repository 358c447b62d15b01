"""Recognition from end to end, in the order of the paper's flowchart (Fig. 2)."""

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from recognition.arrival import receive
from recognition.centre_line import CentreLine, estimate_centre_line
from recognition.chains import make_chains, sharp_bends
from recognition.cover import Cover
from recognition.coverage import unseen_parts
from recognition.crossings import find_crossings
from recognition.ends import extend_ends
from recognition.enhanced import EnhancedMatching, match_enhanced
from recognition.errors import InvalidParametersError
from recognition.fitted_chains import fitted_chains
from recognition.fitted_crossings import fitted_crossings
from recognition.graph import Graph, told_doubts, trace_strands
from recognition.grasps import find_grasps
from recognition.gripper import Gripper
from recognition.joining import Strand
from recognition.matching import match
from recognition.missed_ends import without_missed_ends
from recognition.model import METHODS, Chain, Crossing, Method, PointChainModel, Quality
from recognition.normals import NormalCloud
from recognition.parameters import ChainParameters
from recognition.preprocess import DepthView, Scene, TargetCloud
from recognition.reconstruction import Reconstruction, reconstruct
from recognition.refinement import Refinement, refine
from recognition.registration import Registration, register
from recognition.string_radius import measured_parameters
from recognition.thinning import thin
from recognition.torn_ends import torn_ends
from recognition.unexplained import left_over, unexplained

STAGES = ("preprocess", "registration", "centre_line", "matching", "reconstruction", "refinement", "topology", "grasps")
"""The names that `on_stage` and `timing_s` use, in order; a method has those of `stages_of`."""


def stages_of(method: Method) -> tuple[str, ...]:
    """The stages of one method: `graph` joins what the others reconstruct as it traces, and refines it."""
    return tuple(stage for stage in STAGES if stage != ("reconstruction" if method == "graph" else "refinement"))


@dataclass(frozen=True, eq=False)
class Recognition:
    """A model and what led to it, stage by stage. Stages that were not reached are None."""

    model: PointChainModel
    targets: Sequence[TargetCloud] = ()
    clouds: Sequence[NormalCloud] = ()
    registration: Registration | None = None
    centre_line: CentreLine | None = None
    thinned: NDArray[np.float64] | None = None
    enhanced: EnhancedMatching | None = None
    segments: Sequence[NDArray[np.float64]] = ()
    """(N, 3) each: the linked points before reconstruction."""
    reconstruction: Reconstruction | None = None
    graph: Graph | None = None
    refinement: Refinement | None = None


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
) -> Recognition:
    """The point chain model of the strings in `views`.

    Without `parameters` the string's radius is measured first, which needs all views at once and twice the time.
    `method`: "matching" is the previous method alone (II.G, on the centre line cloud), "enhanced" the paper's
    (III), "graph" ours. Grasps are for `gripper`, the default one if None. `on_stage` is called with the name of
    each stage (`STAGES`) as it begins.

    Raises:
        InvalidParametersError: an unknown method.
        DuplicateViewError: two views with the same index.
        InsufficientViewsError: fewer than two views, or fewer that can be used.
        ContradictingViewsError: no majority of the views shows the same scene.
        NoDepthError: no view measured anything in the workspace.
        TooCrowdedError: far more is above the table than strings.
        RadiusUnknownError: no parameters, and nothing to measure a radius of.
    """
    if method not in METHODS:
        raise InvalidParametersError(f"there is no method {method!r}; it must be one of {', '.join(METHODS)}")
    scene = scene or Scene()
    clock = _Clock(on_stage)

    clock.begin("preprocess")
    views = clock.besides_waiting(views)
    if parameters is None:
        views = list(views)
        parameters = measured_parameters(views, scene)
    arrivals = receive(views, parameters, scene)
    if arrivals.empty_because is not None:
        clock.begin(None)
        unseen = unseen_parts(arrivals.targets, (), scene)
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
    rest = left_over(registration.points, found.chains, parameters)
    chains, torn = torn_ends(without_missed_ends(found.chains, rest, parameters))
    unseen = unseen_parts(arrivals.targets, [view.index for view in registration.views if view.used], scene)

    clock.begin("grasps")
    grasps, ungraspable = find_grasps(
        chains, found.crossings, registration.points, scene, parameters, gripper or Gripper()
    )
    clock.begin(None)

    views_told = tuple(sorted(registration.views + arrivals.left_out, key=lambda view: view.index))
    # What is wrong with the strings themselves comes before what was in the way of seeing them.
    warnings = (*found.warnings, *registration.warnings, *unseen, *unexplained(rest), *ungraspable)
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
        segments = [centre_line.points[segment] for segment in match(centre_line.points, parameters)]
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
    strands, chains, warnings = make_chains(strands, centre_line.single, registration.clouds, scene, parameters)
    crossings, ambiguities = find_crossings(strands, registration.points, parameters)
    stages = {"thinned": thinned, "enhanced": enhanced, "segments": segments, "reconstruction": reconstruction}
    return _Found(chains, crossings, [*ambiguities, *sharp_bends(chains)], warnings, stages)


def _by_graph(
    registration: Registration, centre_line: CentreLine, parameters: ChainParameters, scene: Scene, clock: _Clock
) -> _Found:
    """Our method: strands as paths in a graph, joined all at once, and fitted to the surface."""
    clock.begin("matching")
    cover = Cover(registration.points)
    graph = trace_strands(centre_line.single, cover, parameters)

    clock.begin("refinement")
    refinement = refine(graph.strands, registration.points, registration.normals, parameters, scene.table_z_m)

    clock.begin("topology")
    chains, doubts, warnings = fitted_chains(refinement, registration, cover, scene, parameters)
    crossings, ambiguities = fitted_crossings(chains)
    ambiguities = [*ambiguities, *told_doubts(graph.pairing), *sharp_bends(chains), *doubts]
    return _Found(chains, crossings, ambiguities, warnings, {"graph": graph, "refinement": refinement})

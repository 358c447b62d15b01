"""Recognition from end to end, in the order of the paper's flowchart (Fig. 2)."""

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from recognition.centre_line import CentreLine, estimate_centre_line
from recognition.chains import make_chains, sharp_bends
from recognition.crossings import find_crossings
from recognition.ends import extend_ends
from recognition.enhanced import EnhancedMatching, match_enhanced
from recognition.matching import match
from recognition.model import Method, PointChainModel, Quality
from recognition.normals import NormalCloud, estimate_normals
from recognition.parameters import ChainParameters
from recognition.preprocess import DepthView, Scene, TargetCloud, preprocess
from recognition.reconstruction import Reconstruction, Strand, reconstruct
from recognition.registration import Registration, register
from recognition.thinning import thin
from recognition.unexplained import unexplained
from recognition.usable_views import usable_views

STAGES = ("preprocess", "registration", "centre_line", "matching", "reconstruction", "topology")
"""The names that `on_stage` and `timing_s` use, in order."""


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


def recognise(
    views: Iterable[DepthView],
    parameters: ChainParameters,
    scene: Scene | None = None,
    method: Method = "enhanced",
    on_stage: Callable[[str], None] | None = None,
) -> Recognition:
    """The point chain model of the strings in `views`.

    `method`: "matching" is the previous method alone (II.G, on the centre line cloud), "enhanced" the paper's
    (III). `on_stage` is called with the name of each stage (`STAGES`) as it begins.

    Raises:
        InsufficientViewsError: fewer than two views, or fewer that can be used.
        NoDepthError: no view measured anything in the workspace.
        TooCrowdedError: far more is above the table than strings.
    """
    scene = scene or Scene()
    clock = _Clock(on_stage)

    clock.begin("preprocess")
    targets = [preprocess(view, parameters, scene) for view in views]
    seen, left_out, empty_because = usable_views(targets)
    if empty_because:
        clock.begin(None)
        quality = Quality(views=left_out, warnings=(empty_because,))
        return Recognition(PointChainModel(method, parameters, quality=quality, timing_s=clock.timing_s), targets)
    clouds = [estimate_normals(target, parameters) for target in seen]

    clock.begin("registration")
    registration = register(clouds, parameters)

    clock.begin("centre_line")
    centre_line = estimate_centre_line(registration.points, registration.normals, parameters)

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
    ambiguities = [*ambiguities, *sharp_bends(chains)]
    warnings = [*warnings, *unexplained(registration.points, chains, parameters)]
    clock.begin(None)

    view_quality = tuple(sorted(registration.views + left_out, key=lambda view: view.index))
    quality = Quality(view_quality, tuple(ambiguities), tuple(warnings))
    model = PointChainModel(method, parameters, chains, tuple(crossings), quality, clock.timing_s)
    return Recognition(model, targets, clouds, registration, centre_line, thinned, enhanced, segments, reconstruction)

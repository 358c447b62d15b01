"""Where the views show the table, and the errors of their camera: the one place that measures them.

None of them depends on the radius of the strings, so that a recognition with another radius uses them again. While
views arrive, small changes are ignored: all earlier views would have to be preprocessed again.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from calibration.geometry.transforms import inverse
from recognition.depth_correction.depth_warp import (
    MAX_VIEWS,
    DepthWarp,
    TableSample,
    correct,
    is_similar,
    measure_warp,
    sample_table,
)
from recognition.depth_correction.pixel_locking import (
    LockingSample,
    PixelLocking,
    correct_locking,
    measure_locking,
    sample_locking,
)
from recognition.errors import DuplicateViewError
from recognition.preprocessing.table_measurement import ViewPlane, measure_table
from recognition.preprocessing.target_cloud import DepthView, Scene
from recognition.registration.measured_table import (
    MeasuredTable,
    MovedView,
    is_near,
    locate_table,
    refuse_doubtful_table,
)
from recognition.registration.pose_prior import PoseSigmas

LOCKING_VIEWS = 3
"""Number of views from which pixel locking is measured: the first ones. Each of them shows many disparities."""
EARLY_PLANES = 2
"""Minimum number of views that show the table, for a move of the table while further views may arrive. A single view
shows it less accurately."""


@dataclass(eq=False)
class TableAndWarp:
    """Table and warp as the views so far show them. `add` measures them again with a further view."""

    scene: Scene
    """Table height and workspace, as given."""
    views: list[DepthView] = field(default_factory=list)
    """Views as they arrived."""
    samples: list[TableSample | None] = field(default_factory=list)
    """Pixels on the table in each view as captured; None for a view that shows too little of it."""
    locking_samples: list[LockingSample] = field(default_factory=list)
    """Pixels on the table in the first `LOCKING_VIEWS` views that show enough of it, for the pixel locking."""
    locking: PixelLocking | None = None
    """Error of the camera between whole disparities, or None."""
    is_locking_final: bool = False
    """Whether the locking was measured in `LOCKING_VIEWS` views. Further views do not change it."""
    warp: DepthWarp | None = None
    """Slow depth error of the camera that remains without the locking, or None."""
    without_errors: list[DepthView] = field(default_factory=list)
    """The views with corrected depth images; as they arrived if there are neither locking nor warp."""
    planes: list[ViewPlane | None] = field(default_factory=list)
    """Plane of the table in each view of `without_errors` at its given pose, base frame; None as in `samples`."""
    table: MeasuredTable | None = None
    """Where the views show the table; None if no view shows it."""
    T_base_table: NDArray[np.float64] = field(default_factory=lambda: np.eye(4))
    """(4, 4) motion that moves the given table to where the corrected views have it, metres."""

    @classmethod
    def measure(cls, views: Iterable[DepthView], scene: Scene) -> Self:
        """Return table, pixel locking and warp as all views of a scan show them.

        Raises:
            DuplicateViewError: Two views have the same index.
            TableElsewhereError: The table is too far from where it is given, or two planes may be the table.
        """
        measured = cls(scene)
        planes = [measured._append_captured(view) for view in views]
        measured.locking = measure_locking(measured.locking_samples)
        measured.is_locking_final = len(measured.locking_samples) == LOCKING_VIEWS
        measured.warp = measure_warp(measured._unlocked_samples()[:MAX_VIEWS])
        for view, plane in zip(measured.views, planes, strict=True):
            measured._append_corrected(view, plane)
        measured._locate_table()
        measured.T_base_table = measured._measured_T_base_table()
        measured._refuse_doubtful_table()
        return measured

    def copy(self) -> Self:
        """Return a copy, to which views can be added."""
        return replace(
            self,
            views=[*self.views],
            samples=[*self.samples],
            locking_samples=[*self.locking_samples],
            without_errors=[*self.without_errors],
            planes=[*self.planes],
        )

    def add(self, view: DepthView) -> bool:
        """Add a view. Return whether the views before it are corrected differently now.

        The table is moved as soon as `EARLY_PLANES` views show it where it is not given.

        Raises:
            DuplicateViewError: Two views have the same index.
        """
        plane = self._append_captured(view)
        has_new_errors = self._has_new_errors()
        if has_new_errors:
            self._correct_again()
        else:
            self._append_corrected(view, plane)
        is_moved = self._move_table(EARLY_PLANES)
        return has_new_errors or is_moved

    def finish(self) -> bool:
        """Correct and move what a single view shows, because no view follows. Return as `add`.

        Raises:
            TableElsewhereError: The table is too far from where it is given, or two planes may be the table.
        """
        has_locking = len(self.locking_samples) < LOCKING_VIEWS and self._has_new_locking()
        if has_locking:
            self._correct_again()
        is_moved = self._move_table(1)
        self._refuse_doubtful_table()
        return has_locking or is_moved

    @property
    def pose_sigmas(self) -> PoseSigmas:
        """Standard deviations of the pose errors. Pixel locking shows how far a disparity offset moves the depth."""
        return PoseSigmas.for_disparities(None if self.locking is None else self.locking.period_per_m)

    def corrected(self, number: int) -> DepthView:
        """Return a view without the errors of the camera, with its pose relative to the table.

        Args:
            number: Position of the view in `views`.
        """
        view = self.without_errors[number]
        if np.array_equal(self.T_base_table, np.eye(4)):
            return view
        return MovedView(view, inverse(self.T_base_table) @ view.T_base_camera)

    def _append_captured(self, view: DepthView) -> ViewPlane | None:
        """Add a view as captured, and return the plane of its table. Raises DuplicateViewError."""
        if any(view.index == earlier.index for earlier in self.views):
            raise DuplicateViewError(f"two views have the index {view.index}; give each view its own index")
        plane = measure_table(view, self.scene)
        sample = None if plane is None else sample_table(view, plane, self.scene)
        if plane is not None and len(self.locking_samples) < LOCKING_VIEWS:
            locking_sample = sample_locking(view, plane, self.scene)
            if locking_sample is not None:
                self.locking_samples.append(locking_sample)
        self.views.append(view)
        self.samples.append(sample)
        return plane

    def _correct_again(self) -> None:
        """Correct all views with the present locking and warp."""
        self.without_errors.clear()
        self.planes.clear()
        for view in self.views:
            self._append_corrected(view, None)

    def _append_corrected(self, view: DepthView, plane: ViewPlane | None) -> None:
        """Add a view without locking and warp, and the plane of its table.

        `plane` is that of the captured view. It is not used if the view is corrected.
        """
        if self.locking is not None:
            view = correct_locking(view, self.locking)
        if self.warp is not None:
            view = correct(view, self.warp)
        if self.locking is not None or self.warp is not None:
            plane = measure_table(view, self.scene)
        self.without_errors.append(view)
        self.planes.append(plane)

    def _has_new_errors(self) -> bool:
        """Measure locking and warp in the first views. Return whether one of them has changed."""
        if sum(sample is not None for sample in self.samples) > MAX_VIEWS:
            return False
        is_enough = len(self.locking_samples) == LOCKING_VIEWS
        has_new_locking = is_enough and not self.is_locking_final and self._has_new_locking()
        self.is_locking_final = is_enough
        samples = self._unlocked_samples()
        warp = measure_warp(samples)
        has_new_warp = not is_similar(warp, self.warp, samples)
        if has_new_warp:
            self.warp = warp
        return has_new_locking or has_new_warp

    def _has_new_locking(self) -> bool:
        """Measure the pixel locking. Return whether there is one, or was one before."""
        before = self.locking
        self.locking = measure_locking(self.locking_samples)
        return before is not None or self.locking is not None

    def _unlocked_samples(self) -> list[TableSample]:
        """Return the pixels on the table in the views that show it, without pixel locking."""
        samples = [sample for sample in self.samples if sample is not None]
        locking = self.locking
        if locking is None:
            return samples
        return [
            replace(sample, inverse_depth=sample.inverse_depth - locking.error(sample.inverse_depth))
            for sample in samples
        ]

    def _move_table(self, min_planes: int) -> bool:
        """Locate the table, and move it if at least `min_planes` views show it elsewhere. Return whether it moved."""
        if sum(plane is not None for plane in self.planes) < min_planes:
            return False
        self._locate_table()
        T_base_table = self._measured_T_base_table()
        if is_near(T_base_table, self.T_base_table, self.planes):
            return False
        self.T_base_table = T_base_table
        return True

    def _locate_table(self) -> None:
        """Locate the table in all views that show it."""
        planes = [plane for plane in self.planes if plane is not None]
        self.table = locate_table(planes, self.scene.table_z_m, self.pose_sigmas)

    def _measured_T_base_table(self) -> NDArray[np.float64]:
        """Return the motion (4, 4) of the given table to the measured one; none if pose errors explain it."""
        if self.table is not None and self.table.is_elsewhere:
            return self.table.T_base_table
        return np.eye(4)

    def _refuse_doubtful_table(self) -> None:
        """Raise TableElsewhereError if the table is too far from where it is given, or two planes may be it."""
        if self.table is not None and self.table.is_elsewhere:
            refuse_doubtful_table(self.table, self.planes)

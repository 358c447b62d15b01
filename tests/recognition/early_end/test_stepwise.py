"""Recognition after each view: when it ends, that it equals the recognition of the same views, and why it goes on."""

from collections.abc import Callable, Iterator, Sequence
from functools import cache

import numpy as np
import pytest

from cell.devices import View
from cell.simulation.offline_scan import SimulatedScan, simulate
from cell.simulation.rendering.depth_camera import camera_model
from cell.simulation.scenes.scenes import make_scene
from recognition.early_end.stepwise import recognise_after_each_view
from recognition.early_end.view_sufficiency import ViewCheck
from recognition.errors import NoDepthError
from recognition.pipeline import recognise
from recognition.preprocessing.target_cloud import DepthView, Scene
from recognition.request import RecognitionRequest
from recognition.result import Recognition

RINGS = (3, 1, 7, 5, 4, 2, 0, 6)
"""Viewpoints of the upper ring, then of the lower one."""


@cache
def scanned(name: str, seed: int) -> SimulatedScan:
    return simulate(make_scene(name, seed), camera_model("ideal"), seed)


class Watcher:
    """Takes the views until a check suffices."""

    def __init__(self, scan: SimulatedScan, order: Sequence[int] = RINGS) -> None:
        self.checks: list[ViewCheck] = []
        self.taken: list[View] = []
        self._scan, self._order = scan, order
        self._request = RecognitionRequest(radius_m=scan.truth["radius"])

    def recognise_some(self, views: Sequence[DepthView], earlier: Recognition | None = None) -> Recognition:
        # without a workspace there is no finding on the coverage of the table
        return recognise(views, self._request, Scene(), earlier=earlier)

    def run(self, next_is_here: Callable[[], bool] = lambda: False) -> Recognition:
        return recognise_after_each_view(self._views(), self.recognise_some, self.checks.append, next_is_here)

    def _views(self) -> Iterator[View]:
        for index in self._order:
            self.taken.append(self._scan.views[index])
            yield self.taken[-1]
            if self.checks and self.checks[-1].suffices:
                return


@pytest.mark.parametrize(("name", "seed"), [("figure-eight", 3), ("several", 1)])
def test_a_clear_scene_needs_four_views_and_gives_the_model_of_these(name: str, seed: int) -> None:
    watcher = Watcher(scanned(name, seed))
    recognition = watcher.run()
    assert [check.views for check in watcher.checks] == [3, 4]
    assert watcher.checks[0].doubts[0] == "only 3 views can be used"
    assert watcher.checks[1].suffices
    document, alone = (r.model.to_json() for r in (recognition, watcher.recognise_some(watcher.taken)))
    for model in (document, alone):
        del model["timing_s"]
    assert document == alone  # what was used again of the earlier views changes nothing


def test_an_empty_table_needs_all_views() -> None:
    watcher = Watcher(scanned("empty", 1))
    model = watcher.run().model
    assert len(watcher.taken) == 8
    (found,) = (found for found in model.quality.findings if found.code == "more-views-needed")
    assert found.message.startswith("more than 4 views were needed; after 4 views: no string was found; ")
    assert found.value == 7


@pytest.mark.parametrize("waiting", [(5, 6, 7), (4, 5, 6, 7, 8)])
def test_views_are_not_recognised_while_the_next_one_is_here(waiting: tuple[int, ...]) -> None:
    scan = scanned("empty", 1)
    watcher = Watcher(scan)
    model = watcher.run(lambda: len(watcher.taken) in waiting).model
    assert [check.views for check in watcher.checks] == [k for k in range(3, 9) if k not in waiting]
    assert sum(view.used for view in model.quality.views) == 8


def test_views_that_cannot_be_recognised_yet_are_a_doubt() -> None:
    watcher = Watcher(scanned("figure-eight", 3))
    blind = [View(**{**vars(view), "depth": np.zeros_like(view.depth)}) for view in watcher._scan.views[:2]]

    def views() -> Iterator[View]:
        yield from blind
        yield from (watcher._scan.views[k] for k in (3, 5, 7, 2))

    model = recognise_after_each_view(views(), watcher.recognise_some, watcher.checks.append).model
    on_views = [[doubt for doubt in check.doubts if "can be used" in doubt] for check in watcher.checks[:3]]
    assert on_views == [["only 1 view can be used"], ["only 2 views can be used"], ["only 3 views can be used"]]
    # one view leaves an end unobserved, which comes first; it is seen with the second one
    assert [check.doubts[0] for check in watcher.checks[1:3]] == [on_views[1][0], on_views[2][0]]
    assert watcher.checks[0].doubts[0].startswith("the first end of chain 0")
    assert watcher.checks[3].suffices
    assert len(model.chains) == 1


def test_an_error_of_all_views_is_raised() -> None:
    watcher = Watcher(scanned("figure-eight", 3))
    blind = (View(**{**vars(view), "depth": np.zeros_like(view.depth)}) for view in watcher._scan.views)
    with pytest.raises(NoDepthError):
        recognise_after_each_view(blind, watcher.recognise_some, watcher.checks.append)

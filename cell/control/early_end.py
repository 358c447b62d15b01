"""The decision to end a scan before its last viewpoint, between the caller and the thread that moves the arm."""

import threading

DECISION_TIMEOUT_S = 10.0
"""Longest time that the arm waits for a decision at a viewpoint. Without one, the scan goes on."""


class EarlyEnd:
    """Passes the caller's decisions to the thread `motion`, which waits for each of them at the viewpoint."""

    def __init__(self, min_views: int | None) -> None:
        """Create it without a decision.

        Args:
            min_views: Smallest number of views after which the scan may end. None: all viewpoints are visited.
        """
        self._min_views = min_views
        self._decided = threading.Condition()
        self._views, self._enough, self._closed = 0, False, False

    def decide(self, views: int, enough: bool) -> None:
        """Decide, after a number of views, whether the scan ends with them."""
        with self._decided:
            self._views, self._enough = views, enough
            self._decided.notify_all()

    def close(self) -> None:
        """Let the scan go on without further decisions."""
        with self._decided:
            self._closed = True
            self._decided.notify_all()

    def wait(self, views: int) -> bool:
        """Return whether the scan ends with `views` views.

        The arm waits for the decision at the first viewpoint after which the scan may end. At later ones it waits only
        if the views before sufficed, because what was doubtful mostly stays so until the last view.
        """
        if self._min_views is None or views < self._min_views:
            return False
        with self._decided:
            if views > self._min_views and not self._enough:
                return False
            self._decided.wait_for(lambda: self._closed or self._views >= views, DECISION_TIMEOUT_S)
            return not self._closed and self._views == views and self._enough

"""A scan whose arm moves in a thread of its own, while the caller works on the views."""

import contextlib
import contextvars
import queue
import threading
from collections.abc import Callable, Iterator

from cell.control.early_end import EarlyEnd
from cell.control.progress import MissingView
from cell.devices import View
from cell.errors import MissingViewsError


class BackgroundScan:
    """Take views in the thread `motion`, and pass them to the caller through a queue.

    Iteration ends with the last view. The arm then returns home without the caller.
    """

    def __init__(
        self,
        views: Iterator[View | MissingView],
        return_home: Callable[[], None],
        on_failure: Callable[[BaseException], None],
        early_end: EarlyEnd,
    ) -> None:
        """Create the scan; nothing moves before `running`.

        Args:
            views: Takes a view at each step, or finds that it is missing, in the thread `motion`.
            return_home: Moves the arm home. It is called after the last view, also if too few views were taken.
            on_failure: Called with the error of a failed scan when the arm has ended its motion. It must not wait.
            early_end: For the decisions at the viewpoints, on which `views` waits.
        """
        self.early_end = early_end
        """Takes the decision whether the scan ends with the views so far."""
        self.missing: list[MissingView] = []
        """Missing views. The list is complete when the iteration has ended."""
        self._taking, self._return_home, self._on_failure = views, return_home, on_failure
        self._scan_error: BaseException | None = None
        self._home_error: BaseException | None = None
        self._views: queue.SimpleQueue[View | MissingView | None] = queue.SimpleQueue()
        self._ended = threading.Event()  # a thread whose `join` a signal interrupts would count as ended
        self._ended.set()
        run = contextvars.copy_context().run  # the context of the log, which names the scan
        self._thread = threading.Thread(target=run, args=(self._run,), name="motion", daemon=True)

    @property
    def at_work(self) -> bool:
        """Whether the arm may move."""
        return not self._ended.is_set()

    @property
    def error(self) -> BaseException | None:
        """Error that ended the scan, or None."""
        return self._scan_error or self._home_error

    def next_is_here(self) -> bool:
        """Return whether the iteration goes on at once: with the next view, or to its end."""
        return not self._views.empty()

    def __iter__(self) -> Iterator[View]:
        """Yield each view once, when it is on the disk. A second iteration continues after the first.

        Raises:
            CellError: The scan ended before its last view. `MissingViewsError` means too few views.
            RecordingError: A view cannot be recorded.
            OSError: A view cannot be written.
        """
        while (view := self._views.get()) is not None:
            if isinstance(view, MissingView):
                self.missing.append(view)
            else:
                yield view
        self._views.put(None)  # ends a second iteration
        if self._scan_error is not None:
            raise self._scan_error

    def wait(self) -> None:
        """Wait until the arm is home. Raise the error of the scan or of the return, if any."""
        self.join()
        if self.error is not None:
            raise self.error

    def join(self) -> None:
        """Wait until the arm has ended its motion."""
        self._ended.wait()

    @contextlib.contextmanager
    def running(self, stop: Callable[[], None]) -> Iterator[None]:
        """Run the scan around the body of a `with` statement.

        A body that ends normally waits until the arm is home. If the body raises, an arm that may move is stopped.

        Args:
            stop: Stops the arm.

        Raises:
            BaseException: The error of the body, or else of the scan.
        """
        try:
            self._ended.clear()
            try:
                self._thread.start()
            except RuntimeError:  # the system has no further thread
                self._ended.set()
                raise
            yield
            self.early_end.close()
            self.wait()
        except BaseException as error:
            self.early_end.close()
            # After an error of the scan itself, the arm is at rest or on its way home.
            if error is not self.error and self.at_work:
                stop()
            try:
                self.join()
            except BaseException:  # the wait was interrupted: the arm must not move unattended
                stop()
                self.join()
                raise
            raise

    def _run(self) -> None:
        try:
            try:
                for view in self._taking:
                    self._views.put(view)
            except Exception as error:  # noqa: BLE001 (raised by `__iter__` and `wait`)
                self._scan_error = error
            self._views.put(None)
            # After any other error the arm stays where it is.
            if isinstance(self._scan_error, MissingViewsError | None):
                try:
                    self._return_home()
                except Exception as error:  # noqa: BLE001 (raised by `wait`)
                    self._home_error = error
            # An error of the return matters more than missing views: it may be a fault.
            failure = self._home_error or self._scan_error
            if failure is not None:
                self._on_failure(failure)
        finally:
            self._ended.set()

"""A fit's figures as TensorBoard events, beside whatever else watches it."""

from __future__ import annotations

from pathlib import Path
from types import TracebackType

from prtnet.arrays import FloatArray
from prtnet.errors import PrtnetError
from training.monitor import Monitor

__all__ = ["TensorBoard"]


class TensorBoard:
    """A monitor that writes scalars and histograms to a folder and passes everything on.

    Args:
        folder: of the event file; made if it is not there.
        other: the monitor that shows the fit.

    Raises:
        PrtnetError: the folder cannot be written.
    """

    def __init__(self, folder: Path, other: Monitor) -> None:
        from torch.utils.tensorboard import SummaryWriter

        self.other = other
        try:
            self.writer = SummaryWriter(str(folder))
        except OSError as error:
            raise PrtnetError(folder, f"cannot be written ({error.strerror})") from error

    def __enter__(self) -> TensorBoard:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.writer.close()

    def stage(self, text: str) -> None:
        """Pass on."""
        self.other.stage(text)

    def progress(self, done: int, total: int, loss: float) -> None:
        """Pass on."""
        self.other.progress(done, total, loss)

    def scalar(self, name: str, value: float, step: int) -> None:
        """Write a figure."""
        self.writer.add_scalar(name, value, step)
        self.other.scalar(name, value, step)

    def histogram(self, name: str, values: FloatArray, step: int) -> None:
        """Write a distribution."""
        self.writer.add_histogram(name, values, step)
        self.other.histogram(name, values, step)

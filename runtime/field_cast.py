"""A field to be shown: lobes, the transfer they stand for, what it is on, how it is traced anew."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from prtnet.canvas import Canvas
from prtnet.lobe_field import LobeField
from prtnet.transfer import TransferField
from runtime.worn import Worn

__all__ = ["FieldCast"]


@dataclass(frozen=True, eq=False)
class FieldCast:
    """A field on something.

    Attributes:
        worn: what it is on.
        lobes: as the file has them; None to fit them to transfer.
        transfer: full harmonics; None where only lobes are known.
        retrace: transfer of the canvas as it is posed; called beside the frames, in another
            thread. None where no rays can tell.
        file_bytes: of the field's file; None where there is none.

    Raises:
        ValueError: there are neither lobes nor transfer.
    """

    worn: Worn
    lobes: LobeField | None = None
    transfer: TransferField | None = None
    retrace: Callable[[Canvas], TransferField] | None = None
    file_bytes: int | None = None

    def __post_init__(self) -> None:
        """Refuse a field of neither."""
        if self.lobes is None and self.transfer is None:
            raise ValueError("a field has lobes or transfer")

    @property
    def order(self) -> int:
        """Bands n."""
        field = self.lobes or self.transfer
        assert field is not None
        return field.order

    @property
    def patch(self) -> bool:
        """Whether it is a texture, that may be laid on anything."""
        return self.worn.rest.places is not None

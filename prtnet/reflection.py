"""Reflection product operators ("Arbitrary BRDFs" section 4): any material on SH visibility.

Of a BRDF's k light factors the product matrices M^b, of its view factors their harmonics; radiance
is Σ_b (w^b · y(view)) (light · M^b visibility), eq. 11, all in the receiver's local frame.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from prtnet import sh
from prtnet.arrays import FloatArray
from prtnet.errors import PrtnetError
from prtnet.factors import Factors
from prtnet.storage import HALF_LIMIT

__all__ = ["LOWEST", "ReflectionOperator", "local_view", "operator_of", "reflection_operator"]

LOWEST = 1e-4  # cosine that views from below the horizon are raised to


def local_view(positions: FloatArray, eye: FloatArray, frames: FloatArray) -> FloatArray:
    """Directions (V, 3) to an eye in frames; those below the horizon are raised to it.

    Vertices that look away still colour triangles at the silhouette.
    """
    away = np.asarray(eye, dtype=np.float64) - positions
    local = np.einsum("vji,vj->vi", frames.astype(np.float64), away)
    length = np.maximum(np.linalg.norm(local, axis=1, keepdims=True), 1e-30)
    local = local / length
    local[:, 2] = np.maximum(local[:, 2], LOWEST)
    return np.asarray(local / np.linalg.norm(local, axis=1, keepdims=True))


@dataclass(frozen=True, eq=False)
class ReflectionOperator:
    """A material.

    Attributes:
        matrices: M^b, symmetric, (k, n², n²).
        view: w^b, (k, m², 3), linear RGB.
    """

    matrices: FloatArray
    view: FloatArray

    @property
    def order(self) -> int:
        """Bands n of light and visibility."""
        return sh.order_of(self.matrices[0])

    def factors_of(self, view: FloatArray) -> FloatArray:
        """W^b (…, k, 3) of view directions (…, 3) in the local frame."""
        rows = sh.evaluate(view, sh.order_of(self.view[0, :, 0]))
        return np.einsum("...i,bic->...bc", rows, self.view)

    def transfer(self, visibility: FloatArray, view: FloatArray) -> FloatArray:
        """What light is to be dotted with, (…, n², 3), of visibility (…, n²) seen from (…, 3)."""
        products = np.einsum("bij,...j->...bi", self.matrices, visibility)
        return np.einsum("...bi,...bc->...ic", products, self.factors_of(view))

    def radiance(self, light: FloatArray, visibility: FloatArray, view: FloatArray) -> FloatArray:
        """(…, 3) of light (…, n², 3), visibility (…, n²) and view directions (…, 3)."""
        return (light * self.transfer(visibility, view)).sum(axis=-2)

    def packed(self) -> bytes:
        """Half precision: of every factor the upper triangle of its matrix, then its view factor.

        Raises:
            PrtnetError: a value is beyond half precision.
        """
        rows, columns = np.triu_indices(self.order**2)
        parts = [self.matrices[:, rows, columns], self.view.reshape(len(self.view), -1)]
        both = np.concatenate(parts, axis=1)
        if not np.abs(both).max(initial=0.0) < HALF_LIMIT:
            raise PrtnetError("BRDF", "reflects more than half precision holds; dim it")
        return both.astype("<f2").tobytes()

    @staticmethod
    def unpacked(data: bytes, count: int, order: int = 4) -> ReflectionOperator:
        """The inverse of :meth:`packed`, of k factors and n bands.

        Raises:
            ValueError: the bytes do not fit.
        """
        both = np.frombuffer(data, dtype="<f2").astype(np.float32).reshape(count, -1)
        rows, columns = np.triu_indices(order**2)
        size = (both.shape[1] - len(rows)) / 3.0
        if size < 1 or round(size**0.5) ** 2 != size:
            raise ValueError(f"{len(data)} bytes are no {count} factors of order {order}")
        matrices = np.empty((count, order**2, order**2), dtype=np.float32)
        matrices[:, rows, columns] = matrices[:, columns, rows] = both[:, : len(rows)]
        return ReflectionOperator(matrices, both[:, len(rows) :].reshape(count, -1, 3))


def reflection_operator(
    factors: Factors, order: int = 4, view_order: int = 4
) -> ReflectionOperator:
    """The operator of a BRDF's factors.

    Light factors are taken to 2n − 1 bands: with them light · M^b visibility is exactly the
    integral of the product, for light and visibility of n bands.

    Args:
        factors: of the BRDF and the cosine.
        order: n of light and visibility.
        view_order: m of the view factors.
    """
    return operator_of(*factors.projected(2 * order - 1, view_order), order)


def operator_of(light: FloatArray, view: FloatArray, order: int) -> ReflectionOperator:
    """The operator of light factors (k, (2n − 1)²) and view factors (k, m², 3) in harmonics."""
    product = sh.triple_product(order, order, 2 * order - 1)  # [n², n², (2n − 1)²]
    matrices = np.moveaxis(product @ light.T, -1, 0)
    return ReflectionOperator(matrices.astype(np.float32), view.astype(np.float32))

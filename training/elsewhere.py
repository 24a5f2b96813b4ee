"""Networks fitted in blocks of clusters that travel through files: the same bytes, elsewhere.

Inputs and targets of a block are a file in a folder that every machine sees, and so is its fit.
Names are hashes of all that decides a fit, so the same work, after whatever ended it, finds what
was done before.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import copy_context
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, TypeVar

import torch
from torch import Tensor

from prtnet.array_file import BLOCK, read_arrays, write_arrays
from prtnet.errors import PrtnetError
from prtnet.executor import Tasks
from prtnet.files import remove
from prtnet.provenance import made_with
from training.regression import (
    ELSEWHERE,
    Fit,
    Networks,
    OnIteration,
    total_iterations,
)

__all__ = ["PACKAGES", "FitBlock", "fits_elsewhere", "in_parallel"]

PACKAGES = ("numpy", "torch")  # that decide the bytes of a fit
CLUSTERS = 4  # of a block: fewer waste time on small products, more leave workers without any
TENSORS = ("weight", "bias", "hidden_weight", "hidden_bias", "loss", "iterations")

Item = TypeVar("Item")
Result = TypeVar("Result")


@dataclass(frozen=True)
class FitBlock:
    """The task: the networks of a block of clusters.

    Attributes:
        folder: of the files.
        data: what the files of inputs and targets are called, before the block's number.
        fit: likewise those of the fits.
        how: networks are fitted.
        clusters: in all blocks.
    """

    folder: Path
    data: str
    fit: str
    how: Networks
    clusters: int

    def __call__(self, number: int, pool: Executor) -> None:
        """Fit block ``number``, in one thread: the others of a worker have blocks of their own."""
        del pool
        torch.set_num_threads(1)
        path = self.folder / f"{self.data}-{number}"
        if not path.is_file():
            raise PrtnetError(
                self.folder,
                "is not there on a worker; put --out where every machine sees it by this name",
            )
        _, arrays = read_arrays(path, BLOCK)
        x, t = (torch.from_numpy(arrays[name]) for name in ("inputs", "targets"))
        found = self.how(x, t, first=number * CLUSTERS, of=self.clusters)
        known = {name: getattr(found, name).numpy() for name in TENSORS}
        path = self.folder / f"{self.fit}-{number}"
        write_arrays(path, {"status": found.status}, known, BLOCK)

    def read(self, number: int) -> Fit:
        """The fit of block ``number``, that was done."""
        header, arrays = read_arrays(self.folder / f"{self.fit}-{number}", BLOCK)
        tensors = {name: torch.from_numpy(arrays[name]) for name in TENSORS}
        return Fit(**tensors, status=header["status"])


@dataclass(frozen=True)
class Elsewhere:
    """Fits networks as tasks.

    Attributes:
        tasks: what runs them.
        folder: that all of its machines see.
        made: by which versions.
    """

    tasks: Tasks
    folder: Path
    made: Mapping[str, Any]

    def __call__(
        self, how: Networks, x: Tensor, t: Tensor, on_iteration: OnIteration | None
    ) -> Fit:
        """As ``how(x, t)``; told of whole blocks, as if of all iterations in equal parts.

        Raises:
            PrtnetError: files cannot be written, or no cluster does the work.
        """
        task = self.prepared(how, x, t)
        blocks = range(-(-len(x) // CLUSTERS))
        there = {path.name for path in self.folder.iterdir()}
        for block in blocks:
            if f"{task.data}-{block}" not in there:
                own = slice(block * CLUSTERS, (block + 1) * CLUSTERS)
                parts = {"inputs": x[own].numpy(), "targets": t[own].numpy()}
                write_arrays(self.folder / f"{task.data}-{block}", {}, parts, BLOCK)
        fits = {block: task.read(block) for block in blocks if f"{task.fit}-{block}" in there}
        left = [block for block in blocks if block not in fits]
        limit = total_iterations(how.iterations, how.restarts)
        for block in self.tasks.run(task, left, ahead=torch.get_num_threads()):
            fits[block] = task.read(block)
            if on_iteration is not None:
                losses = torch.cat([fit.loss for fit in fits.values()])
                on_iteration(limit * len(fits) // len(blocks) - 1, losses)
        return joined([fits[block] for block in blocks])

    def prepared(self, how: Networks, x: Tensor, t: Tensor) -> FitBlock:
        """The task, its files named by what is in them."""
        digest = hashlib.sha256(json.dumps([CLUSTERS, x.shape, t.shape, str(x.dtype)]).encode())
        for tensor in (x, t):
            digest.update(tensor.contiguous().numpy().tobytes())
        data = digest.hexdigest()[:32]
        text = json.dumps([data, asdict(how), dict(self.made)], sort_keys=True)
        fit = hashlib.sha256(text.encode()).hexdigest()[:32]
        return FitBlock(self.folder, data, fit, how, len(x))


def joined(fits: Sequence[Fit]) -> Fit:
    """The fits of blocks as one."""
    tensors = {name: torch.cat([getattr(fit, name) for fit in fits]) for name in TENSORS}
    return Fit(**tensors, status=[text for fit in fits for text in fit.status])


@contextmanager
def fits_elsewhere(tasks: Tasks, folder: Path) -> Iterator[None]:
    """Inside, networks are fitted as tasks; what that leaves in the folder is deleted if all ends
    well, else a next time goes on with it.

    Args:
        tasks: what runs them.
        folder: that all machines of theirs see by this name; made where there is none.

    Raises:
        PrtnetError: the folder cannot be made.
    """
    folder = folder.resolve()
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        reason = error.strerror or str(error)
        raise PrtnetError(folder, f"cannot be made ({reason}); give another --out") from error
    threads = torch.get_num_threads()
    token = ELSEWHERE.set(Elsewhere(tasks, folder, made_with(*PACKAGES)))
    try:
        yield
    finally:
        ELSEWHERE.reset(token)
        torch.set_num_threads(threads)  # tasks in threads of this process have set it
    remove(folder)


def in_parallel(function: Callable[[Item], Result], items: Sequence[Item]) -> list[Result]:
    """The function of all items: in turn, or at once where networks are fitted elsewhere."""
    if ELSEWHERE.get() is None or len(items) < 2:
        return [function(item) for item in items]
    contexts = [copy_context() for _ in items]
    with ThreadPoolExecutor(len(items)) as pool:
        return list(pool.map(lambda context, item: context.run(function, item), contexts, items))

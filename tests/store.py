"""A store that several processes see, whose clients remember what they listed, as s3fs does."""

from __future__ import annotations

import os
import warnings
from typing import Any

import fsspec
from fsspec.implementations.local import LocalFileSystem

__all__ = ["Farm"]


UNSEEN = ".under-way"


class Farm(LocalFileSystem):  # type: ignore[misc]
    """``farm:///folder`` is that folder of this machine; files are put there whole, or not seen."""

    protocol = "farm"

    def __init__(self, **options: Any) -> None:
        super().__init__(auto_mkdir=True, **options)

    @classmethod
    def _strip_protocol(cls, path: Any) -> str:
        return super()._strip_protocol(os.fspath(path).removeprefix("farm://"))

    def unstrip_protocol(self, name: str) -> str:
        return f"farm://{self._strip_protocol(name)}"

    def ls(self, path: str, detail: bool = False, **_: Any) -> Any:
        folder = self._strip_protocol(path)
        found = self.dircache.get(folder)
        if found is None:
            every = super().ls(folder, detail=True)
            found = [each for each in every if not each["name"].endswith(UNSEEN)]
            self.dircache[folder] = found
        return found if detail else [each["name"] for each in found]

    def info(self, path: str, **options: Any) -> Any:
        own = self._strip_protocol(path)
        folder = os.path.dirname(own)
        if folder in self.dircache and own not in {e["name"] for e in self.dircache[folder]}:
            raise FileNotFoundError(own)
        return super().info(own, **options)

    def exists(self, path: str, **_: Any) -> bool:
        try:
            self.info(path)
        except FileNotFoundError:
            return False
        return True

    def pipe_file(self, path: str, value: bytes, **_: Any) -> None:
        own = self._strip_protocol(path)
        os.makedirs(os.path.dirname(own), exist_ok=True)
        partial = f"{own}.{os.getpid()}{UNSEEN}"
        with open(partial, "wb") as file:
            file.write(value)
        os.replace(partial, own)
        self.dircache.pop(os.path.dirname(own), None)


warnings.filterwarnings("ignore", "UPath 'farm' filesystem")
fsspec.register_implementation("farm", Farm, clobber=True)

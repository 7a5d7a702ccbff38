"""Fetching through pooch: checked by sha256, resumed after an interruption, moved to its place only when complete."""

from __future__ import annotations

import shutil
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mapmend.datasets.cache import CACHE_VARIABLE, cache_folder, is_fetched
from mapmend.datasets.registry import Dataset, RemoteFile
from mapmend.errors import MapmendError, OutputError
from mapmend.parallel import Progress, no_progress

if TYPE_CHECKING:
    import requests

EXTRA = "pip install 'mapmend[datasets]'"
_TRIES = 4
_PAUSE_S = 0.5
_TIMEOUT_S = (10.0, 30.0)  # to connect, and between two pieces
_PIECE_BYTES = 1 << 16
_PARTIAL, _OK, _UNSATISFIABLE = 206, 200, 416


def fetch(dataset: Dataset, *, mirror: str | None = None, progress: Progress = no_progress) -> list[Path]:
    """Fetches the missing files, and returns the paths of the dataset's files.

    ``mirror``: an address that holds the files by their names, instead of their own addresses. Raises MapmendError if
    there is no network or the content is not the pinned one, OutputError if the cache cannot be written.
    """
    return [_fetch_file(file, mirror, progress) for file in dataset.files]


def _fetch_file(file: RemoteFile, mirror: str | None, progress: Progress) -> Path:
    place = cache_folder() / file.name
    if is_fetched(file):
        return place
    try:
        import pooch
        import requests
    except ModuleNotFoundError as error:
        raise MapmendError(f"{str(error.name).split('.', 1)[0]} is not installed; {EXTRA}") from None
    pooch.get_logger().setLevel("WARNING")
    url = file.url if mirror is None else f"{mirror.rstrip('/')}/{file.name}"
    download = ResumedDownload(file, place.with_name(place.name + ".part"), progress)
    try:
        pooch.retrieve(url, f"sha256:{file.sha256}", file.name, cache_folder(), downloader=download)
    except requests.RequestException as error:
        what = f"{file.name}: can't be fetched from {url} ({_reason(error)})"
        raise MapmendError(f"{what}; check the network, or put the file into {cache_folder()} yourself") from None
    except ValueError:
        download.part.unlink(missing_ok=True)
        what = f"{file.name}: what {url} holds is not the file that mapmend knows (its sha256 differs)"
        raise MapmendError(f"{what}; nothing of it was kept") from None
    except OSError as error:
        what = f"{cache_folder()}: can't be written ({error.strerror or error})"
        raise OutputError(f"{what}; name another folder with {CACHE_VARIABLE}") from None
    download.part.unlink(missing_ok=True)
    return place


class ResumedDownload:
    """A downloader for pooch that keeps the received bytes in ``part`` and requests the rest, now or in the next
    call."""

    def __init__(self, file: RemoteFile, part: Path, progress: Progress = no_progress) -> None:
        self.file, self.part, self.progress = file, part, progress

    def __call__(self, url: str, output_file: str, pooch: Any) -> None:
        """Called by pooch, which then checks ``output_file`` and moves it to its place."""
        import requests

        for attempt in range(_TRIES):
            try:
                self._take_rest(url)
                break
            except (requests.ConnectionError, requests.Timeout, requests.exceptions.ChunkedEncodingError):
                if attempt == _TRIES - 1:
                    raise
                time.sleep(_PAUSE_S * attempt)
        shutil.copyfile(self.part, output_file)

    def _take_rest(self, url: str) -> None:
        """Appends the missing bytes; starts from the beginning if the server does not support ranges."""
        import requests

        have = self.part.stat().st_size if self.part.exists() else 0
        # Sizes count the bytes of the file itself, so the server must not compress the answer.
        headers = {"Accept-Encoding": "identity"} | ({"Range": f"bytes={have}-"} if have else {})
        with requests.get(url, headers=headers, stream=True, timeout=_TIMEOUT_S) as answer:
            if answer.status_code == _UNSATISFIABLE and have:
                return  # nothing is missing; the hash verifies this
            answer.raise_for_status()
            have = have if answer.status_code == _PARTIAL else 0
            total = self._append(answer, have)
        if total is not None and self.part.stat().st_size < total:
            raise requests.ConnectionError(f"ended after {self.part.stat().st_size} of {total} bytes")

    def _append(self, answer: requests.Response, have: int) -> int | None:
        """The pieces of an answer after the first ``have`` bytes; and the length of the whole, if the server gave
        it."""
        length = answer.headers.get("Content-Length", "")
        total = have + int(length) if length.isdigit() else None
        with self.part.open("r+b" if have else "wb") as stream:
            stream.seek(have)
            stream.truncate()
            for piece in _pieces(answer):
                stream.write(piece)
                self.progress(self.file.name, stream.tell(), total or self.file.size_bytes or stream.tell())
        return total


def _pieces(answer: requests.Response) -> Iterator[bytes]:
    """The bytes as soon as they have arrived: requests' own loop loses the last, incomplete piece."""
    import requests
    from urllib3.exceptions import HTTPError

    read = getattr(answer.raw, "read1", answer.raw.read)
    try:
        while piece := read(_PIECE_BYTES):
            yield piece
    except HTTPError as error:
        raise requests.ConnectionError(error) from error


def _reason(error: requests.RequestException) -> str:
    """Why a request failed, in a few words."""
    if error.response is not None:
        return f"the server answers {error.response.status_code}"
    cause: BaseException = error
    while cause.args and isinstance(cause.args[0], BaseException):
        cause = cause.args[0]
    inner = getattr(cause, "reason", None)
    text = str(inner if inner is not None else cause)
    return " ".join(text.split("): ", 1)[-1].split())[:120] or type(error).__name__

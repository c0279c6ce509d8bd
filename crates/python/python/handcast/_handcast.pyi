from os import PathLike
from typing import Any, final

import numpy as np
from numpy.typing import NDArray
from typing_extensions import Self

from . import ANGLES as ANGLES
from . import JOINTS as JOINTS
from . import Clip as Clip
from . import Error as Error
from . import Hand as Hand
from . import HandcastWarning as HandcastWarning
from . import LiveDecoder as LiveDecoder
from . import LiveEncoder as LiveEncoder
from . import Pose as Pose
from . import __version__ as __version__
from . import decode as decode
from . import encode as encode
from . import load as load
from . import to_format as to_format
from . import to_glb as to_glb
from . import to_pose_format as to_pose_format

__all__ = [
    "ANGLES",
    "JOINTS",
    "Clip",
    "Corpus",
    "Error",
    "Hand",
    "HandcastWarning",
    "LiveDecoder",
    "LiveEncoder",
    "Pose",
    "Tracker",
    "Worker",
    "__version__",
    "_clip",
    "_hand",
    "_pose",
    "check_run",
    "decode",
    "encode",
    "given_up",
    "load",
    "net_digest",
    "read_person",
    "to_format",
    "to_glb",
    "to_pose_format",
    "track",
]

_Path = str | PathLike[str]

def track(source: Any, fps: float | None, words: dict[str, Any]) -> Clip: ...

@final
class Tracker:
    def __new__(cls, fps: float, words: dict[str, Any]) -> Self: ...
    def push(self, frame: NDArray[np.uint8], time: float | None = None) -> list[Pose]: ...
    def finish(self) -> list[Pose]: ...
    def clip(self, poses: list[Pose]) -> Clip: ...
    @property
    def skin_tone(self) -> int | None: ...

@final
class Corpus:
    def __new__(
        cls, input: _Path, output: _Path, settings: str, only: list[str], checksum: bool, retry: bool
    ) -> Self: ...
    def todo(self) -> list[str]: ...
    def known(self) -> tuple[int, int]: ...
    def settings(self) -> str: ...
    def record(self, outcome: str) -> bool: ...
    def finish(self) -> tuple[str, str]: ...

@final
class Worker:
    def __new__(cls, input: _Path, output: _Path, settings: str, net: _Path | None = None) -> Self: ...
    def work(self, item: str) -> str: ...

def check_run(settings: str, only: list[str]) -> None: ...
def given_up(item: str, settings: str, error: str) -> str: ...
def net_digest(net: _Path | bool | None = None) -> str | None: ...
def read_person(path: _Path) -> str: ...
def _clip(header: str, rows: NDArray[np.float64], baps: str | None) -> Clip: ...
def _hand(header: str, rows: NDArray[np.float64]) -> Hand: ...
def _pose(header: str, rows: NDArray[np.float64]) -> Pose: ...

from collections.abc import Iterable, Sequence
from os import PathLike
from typing import Literal, final

import numpy as np
from numpy.typing import NDArray
from typing_extensions import Self

__all__ = [
    "ANGLES",
    "JOINTS",
    "Clip",
    "Error",
    "Hand",
    "Pose",
    "Tracker",
    "__version__",
    "decode",
    "encode",
    "load",
    "to_format",
    "to_glb",
    "to_pose_format",
    "track",
]

__version__: str

ANGLES: list[str]
"""Names of the 29 joint angles, in the order of the columns of Hand.angles."""
JOINTS: list[str]
"""Names of the 25 joints as WebXR has them, in the order of Hand.joints."""

_Floats = NDArray[np.float64]
_Picture = NDArray[np.uint8]
_Path = str | PathLike[str]
_Side = Literal["left", "right"]
_View = Literal["palm", "back"]
_Start = Literal["open", "any"]

class Error(ValueError):
    """What could not be done, in one line."""

@final
class Hand:
    """One hand over time: T poses. Each attribute is a new array."""

    def __new__(
        cls,
        side: _Side,
        angles: _Floats,
        *,
        wrist: _Floats | None = None,
        times: _Floats | None = None,
        rate: float = 30.0,
        confidence: _Floats | None = None,
        valid: NDArray[np.bool_] | None = None,
        like: Hand | None = None,
    ) -> Self:
        """Poses of arrays as the attributes have them. Without times they are `rate` a second; sizes are those of `like`."""
    def __len__(self) -> int: ...
    @property
    def side(self) -> _Side: ...
    @property
    def times(self) -> _Floats:
        """T: seconds from the start of the clip."""
    @property
    def angles(self) -> _Floats:
        """T×29: radians, in the order of ANGLES. Flexion is positive when a finger closes, abduction when it leaves the
        middle finger, on both hands."""
    @property
    def wrist(self) -> _Floats:
        """T×4×4: from the hand's frame to the camera's, metres; acts on columns. The unturned hand shows its palm to the
        viewer, fingers up."""
    @property
    def joints(self) -> _Floats:
        """T×25×3: places of the joints in the camera's frame, metres, in the order of JOINTS."""
    @property
    def confidence(self) -> _Floats:
        """T: 0 to 1, from 0.5 on little doubt; NaN where nothing is known."""
    @property
    def valid(self) -> NDArray[np.bool_]:
        """T: false where the hand was lost, and the pose is a guess."""

@final
class Pose:
    """One hand at one instant."""

    @property
    def side(self) -> _Side: ...
    @property
    def time(self) -> float:
        """Seconds."""
    @property
    def angles(self) -> _Floats:
        """29: radians, as Hand.angles."""
    @property
    def wrist(self) -> _Floats:
        """4×4, as Hand.wrist."""
    @property
    def joints(self) -> _Floats:
        """25×3: metres, as Hand.joints."""
    @property
    def confidence(self) -> float:
        """0 to 1, or NaN."""
    @property
    def valid(self) -> bool: ...

@final
class Clip:
    """One hand or two over time."""

    def __new__(
        cls, hands: Sequence[Hand], rate: float | None = None, *, skin_tone: int | None = None
    ) -> Self:
        """Hands as one clip, at `rate` frames per second where they are even."""
    @property
    def rate(self) -> float:
        """Frames per second."""
    @property
    def skin_tone(self) -> int | None:
        """Tone of the skin, 1 (lightest) to 10, where it is known: glTF files have it."""
    @property
    def hands(self) -> list[Hand]: ...
    @property
    def left(self) -> Hand | None: ...
    @property
    def right(self) -> Hand | None: ...

def track(
    source: _Path | Iterable[_Picture],
    *,
    fps: float | None = None,
    hand: _Side | None = None,
    view: _View | None = None,
    mirror: bool = False,
    start: _Start = "open",
    smooth: tuple[float, float] | None = None,
    person: _Path | None = None,
    hand_length: float = 0.189,
    fov: float = 60.0,
    net: _Path | None = None,
) -> Clip: ...

class Tracker:
    def __init__(
        self,
        *,
        fps: float = 30.0,
        hand: _Side | None = None,
        view: _View | None = None,
        mirror: bool = False,
        start: _Start = "open",
        smooth: tuple[float, float] | None = None,
        person: _Path | None = None,
        hand_length: float = 0.189,
        fov: float = 60.0,
        net: _Path | None = None,
    ) -> None: ...
    def push(self, frame: _Picture, time: float | None = None) -> list[Pose]: ...
    def finish(self) -> list[Pose]: ...

def encode(
    clip: Clip,
    *,
    target_rms: float | None = None,
    max_error: float | None = None,
    max_error_mm: float | None = None,
    bitrate: float | None = None,
    quant: int | None = None,
    intra: float = 5.0,
    resync: bool = False,
) -> bytes:
    """The clip as an FBA stream.

    One aim at most: target_rms in degrees (0.4 by default), max_error of an angle in degrees, max_error_mm of a fingertip,
    bitrate in kbit/s, quant 0 to 31. intra: seconds between I planes; resync: each can be started at.
    """

def decode(stream: bytes) -> Clip:
    """A whole FBA stream as poses, of hands of the sizes that it carries."""

def load(path: _Path) -> Clip:
    """The poses in a motion file: all kinds that `handcast encode` reads."""

def to_format(clip: Clip, format: str) -> bytes:
    """The clip as a file: "glb", "jsonl", "json", "csv", "bvh", "vrma", "webxr", "landmarks", "pose", "bap"."""

def to_glb(clip: Clip) -> bytes: ...
def to_pose_format(clip: Clip) -> bytes: ...

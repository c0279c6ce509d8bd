from collections.abc import Iterable, Sequence
from os import PathLike
from typing import Any, ClassVar, Literal, final

import numpy as np
from numpy.typing import ArrayLike, NDArray
from typing_extensions import Buffer, Self

__all__ = [
    "ANGLES",
    "JOINTS",
    "Clip",
    "Error",
    "Hand",
    "HandcastWarning",
    "LiveDecoder",
    "LiveEncoder",
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

class HandcastWarning(UserWarning):
    """What was done, but not quite as asked for: times that were resampled, wrists out of reach, bytes left out."""

@final
class Hand:
    """One hand over time: T poses. Each attribute is a new array."""

    def __new__(
        cls,
        side: _Side,
        angles: ArrayLike,
        *,
        wrist: ArrayLike | None = None,
        times: ArrayLike | None = None,
        rate: float | None = None,
        confidence: ArrayLike | None = None,
        valid: ArrayLike | None = None,
        like: Hand | Pose | None = None,
    ) -> Self:
        """Poses of arrays as the attributes have them, or lists. Without times they are `rate` a second, 30 where neither is
        given; both are refused. Sizes are those of `like`. Raises Error that names the argument, and the frame where there is one."""
    def __eq__(self, other: object, /) -> bool: ...
    def __reduce__(self) -> tuple[Any, ...]: ...
    __hash__: ClassVar[None]  # type: ignore[assignment]
    def __len__(self) -> int: ...
    @property
    def side(self) -> _Side: ...
    @property
    def sizes(self) -> dict[str, Any] | None:
        """Sizes of the hand in metres, as the morphology of a person file; None where they are not known."""
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
    """One hand at one instant, as a Tracker gives it."""

    def __eq__(self, other: object, /) -> bool: ...
    def __reduce__(self) -> tuple[Any, ...]: ...
    __hash__: ClassVar[None]  # type: ignore[assignment]
    @property
    def side(self) -> _Side: ...
    @property
    def sizes(self) -> dict[str, Any] | None:
        """Sizes of the hand in metres, as Hand.sizes: those that were known when it was found."""
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
    def __eq__(self, other: object, /) -> bool: ...
    def __reduce__(self) -> tuple[Any, ...]: ...
    __hash__: ClassVar[None]  # type: ignore[assignment]
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

@final
class LiveEncoder:
    """Poses to the bytes of a live stream, as they come: one end of a socket, LiveDecoder is the other.

    rate: frames per second, those of the camera. One aim at most: target_rms in degrees (0.5 by default), max_error of an angle
    in degrees, max_error_mm of a fingertip in millimetres, bitrate in kbit/s, quant 0 to 31. intra: seconds between the planes
    at which a reader can begin."""

    def __new__(
        cls,
        *,
        rate: float = 30.0,
        target_rms: float | None = None,
        max_error: float | None = None,
        max_error_mm: float | None = None,
        bitrate: float | None = None,
        quant: int | None = None,
        intra: float = 5.0,
    ) -> Self: ...
    def push(
        self, poses: Iterable[Pose | Hand], time: float | None = None, *, skin_tone: int | None = None
    ) -> bytes:
        """The bytes (whole planes, none while nothing moves) of an instant: poses as Tracker.push gives them, or Hands of
        arrays; none where no hand is seen. time: seconds, by default those of the last pose, or a frame after the push
        before."""
    def request_intra(self) -> None:
        """Has the next plane be one at which a reader can begin, as soon as the rate has room for it."""
    def finish(self) -> bytes:
        """The bytes that end the stream."""
    @property
    def hands(self) -> list[_Side]:
        """The hands that the stream carries at the moment."""

@final
class LiveDecoder:
    """The bytes of a live stream to poses, as they come in pieces of any length.

    It may begin in the middle of a stream. With conceal, damage is no error: a hand keeps its last pose, not valid and with
    less and less confidence, up to the next I plane."""

    def __new__(cls, *, conceal: bool = True) -> Self: ...
    def push(self, data: Buffer, *, whole: bool = False) -> list[Pose]:
        """The poses that are known with these bytes. whole: they end with a plane, as what LiveEncoder.push gives does: its poses
        do not wait for what follows."""
    def lose(self) -> list[Pose]:
        """Says that bytes are missing here; the poses that were known."""
    def finish(self) -> list[Pose]:
        """No more bytes come: the poses that are left."""
    @property
    def rate(self) -> float:
        """Frames per second."""
    @property
    def skin_tone(self) -> int | None:
        """Tone of the skin, 1 (lightest) to 10; None where the stream has told none."""

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
    net: _Path | Literal[False] | None = None,
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
        net: _Path | Literal[False] | None = None,
    ) -> None: ...
    def push(self, frame: _Picture, time: float | None = None) -> list[Pose]: ...
    def finish(self) -> list[Pose]: ...
    def clip(self, poses: Sequence[Pose]) -> Clip: ...
    @property
    def skin_tone(self) -> int | None: ...

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
    live: bool = False,
    sizes: bool = True,
    max_gap: float = 0.25,
) -> bytes:
    """The clip as an FBA stream, the bytes of `handcast encode`.

    One aim at most: target_rms in degrees (0.4 by default), max_error of an angle in degrees (0.15 to 180), max_error_mm of
    a fingertip as a viewer sees it in millimetres (0.75 to 1000), bitrate in kbit/s, quant 0 to 31. intra: seconds between
    I planes; resync: each of them can be started at, as with live, which plans without look-ahead. sizes=False leaves out
    the person's sizes and tone of skin. Gaps of up to max_gap seconds between two valid poses are interpolated, longer ones
    hold the last pose; so do all with live, or 0. What load() read of a stream or BAP text is coded anew from its BAPs.

    Warns of wrists out of reach, lost poses, times that are resampled, late starts and aims that were missed. Ctrl-C ends the wait.
    """

def decode(stream: Buffer, *, conceal: bool = False) -> Clip:
    """A whole FBA stream as poses, of hands of the sizes that it carries. Warns of bytes before and behind it, of further
    streams, and where these tell different sizes of a hand, of which the clip has the last. With conceal damage is no error:
    the hand keeps its last pose, not valid, to where a decoder can start again, and a warning says what was damaged."""

def load(path: _Path) -> Clip:
    """The poses in a motion file: all kinds that `handcast encode` reads; of a stream nothing is warned of that decode() warns
    of. Raises Error, FileNotFoundError and other OSError."""

def to_format(clip: Clip, format: str) -> bytes:
    """The clip as a file: "glb", "gltf", "jsonl", "json", "csv", "bvh", "vrma", "webxr", "landmarks", "pose", "bap"."""

def to_glb(clip: Clip) -> bytes: ...
def to_pose_format(clip: Clip) -> bytes: ...
